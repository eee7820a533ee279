// The Watch screen: asks for the newest picture as soon as it has drawn the one before.
import { appeared, units as readersUnits } from "./format.js";
import { Charts } from "./charts.js";
import { MapView } from "./map.js";
import { Overlay } from "./overlay.js";
import { Player } from "./player.js";
import { Status } from "./status.js";

const LATE_S = 2.0, RETRY_MS = 500;
const LEAST_MS = 80; // between two pictures: twelve a second look smooth, and a phone stays cool

const about = JSON.parse((await appeared("qt-watch")).dataset.about);
const status = new Status(document.getElementById("qt-status"), document.getElementById("qt-said"));
const overlay = new Overlay(document.getElementById("qt-overlay"));
const image = document.getElementById("qt-image");
const player = about.live ? null : new Player(about);
const map = new MapView(player), charts = new Charts(about, player);
const frame = document.getElementById("qt-picture"), missing = document.getElementById("qt-nopicture");
const now_s = () => performance.now() / 1000;
let socket = null, fresh_s = now_s(), asked = false, sent_ms = 0, newest = null;

const units = document.getElementById("qt-units");
units.value = readersUnits();
units.addEventListener("change", () => {
  localStorage.setItem("qt-units", units.value);
  document.dispatchEvent(new CustomEvent("qt-units"));
  overlay.draw();
  status.show();
});

function ask() {
  if (document.hidden || asked || socket?.readyState !== WebSocket.OPEN) return;
  asked = true;
  sent_ms = performance.now();
  socket.send(player ? `at ${player.t_s.toFixed(3)}` : "next");
}

async function take(buffer) {
  if (buffer.byteLength < 4) return;
  const length = new DataView(buffer).getUint32(0);
  const { state, drawing } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  if (buffer.byteLength > 4 + length) {
    const bitmap = await createImageBitmap(new Blob([new Uint8Array(buffer, 4 + length)], { type: "image/jpeg" }));
    if (image.width !== bitmap.width || image.height !== bitmap.height) {
      image.width = bitmap.width;
      image.height = bitmap.height;
      frame.style.aspectRatio = `${bitmap.width} / ${bitmap.height}`;
    }
    image.getContext("2d").drawImage(bitmap, 0, 0);
    bitmap.close();
    missing.hidden = true;
    frame.classList.remove("qt-old");
  } else {
    gone(about.live ? "No picture now" : "Open the run with --video to see its pictures");
  }
  if (state.number !== newest?.number) fresh_s = now_s();
  newest = state;
  document.getElementById("qt-watch").dataset.t = state.t_s ?? "";
  overlay.take(drawing, state.t_s);
  status.take(state);
  window.qtDrawn = (window.qtDrawn ?? 0) + 1;
}

function gone(words) {
  missing.textContent = words;
  missing.hidden = false;
  frame.classList.add("qt-old");
  overlay.clear();
}

function connect() {
  const scheme = location.protocol === "https:" ? "wss" : "ws";
  const made = new WebSocket(`${scheme}://${location.host}/console/pictures`);
  made.binaryType = "arraybuffer";
  socket = made;
  made.onopen = () => { asked = false; ask(); };
  made.onmessage = async (event) => {
    try {
      await take(event.data);
    } finally {
      asked = false;
      if (player) player.drawn(ask);
      else setTimeout(ask, Math.max(LEAST_MS - (performance.now() - sent_ms), 0));
    }
  };
  made.onclose = () => setTimeout(connect, RETRY_MS);
}

document.addEventListener("visibilitychange", ask);
player?.onSeek(() => ask());
setInterval(() => {
  if (!about.live) return status.tick(null);
  const silent_s = now_s() - fresh_s;
  const late = silent_s > LATE_S && !document.hidden;
  if (late) gone("No new picture");
  status.tick(late ? silent_s : null, socket?.readyState === WebSocket.OPEN);
}, 200);
connect();
map.start();
charts.start();
