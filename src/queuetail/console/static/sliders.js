// The paper's sliders: the mask and the blobs follow while they move.
import { get, save } from "./board.js";
import { fixed } from "./format.js";

const EVERY_MS = 250;
const by = (id) => document.getElementById(id);
const units = { "qt-blur": "px", "qt-dilate": "px", "qt-blob": "px²", "qt-slow": "mph" };
const mask = by("qt-mask"), moment = by("qt-moment");
const value = (id) => Number(by(id).value);
let url = null;

const { sliders } = await get("/api/v1/sliders");
by("qt-blur").value = sliders.blur_px | 1;
by("qt-dilate").value = sliders.dilate_px;
by("qt-blob").value = sliders.min_blob_px2;
by("qt-slow").value = sliders.queue_speed_mph;

function label(id) {
  const input = by(id);
  input.nextElementSibling.textContent = fixed(Number(input.value), 0, units[id]);
  input.setAttribute("aria-valuetext", input.nextElementSibling.textContent);
}
for (const id of Object.keys(units)) {
  label(id);
  by(id).addEventListener("input", () => label(id));
}

async function look() {
  if (!document.hidden) {
    const at = moment ? `&t_s=${moment.value}` : "";
    const query = `blur_px=${value("qt-blur")}&dilate_px=${value("qt-dilate")}&min_blob_px2=${value("qt-blob")}${at}`;
    try {
      const reply = await fetch(`/api/v1/sliders/mask?${query}`, { cache: "no-store" });
      if (reply.ok) {
        const fresh = URL.createObjectURL(await reply.blob());
        mask.src = fresh;
        mask.dataset.query = query;
        if (url) URL.revokeObjectURL(url);
        url = fresh;
      }
    } catch { /* the next round tries again */ }
  }
  setTimeout(look, EVERY_MS);
}
look();

by("qt-useslid").addEventListener("click", async () => {
  const body = { sliders: { blur_px: value("qt-blur"), dilate_px: value("qt-dilate"), min_blob_px2: value("qt-blob"), queue_speed_mph: value("qt-slow") } };
  try {
    const used = await save("/api/v1/sliders", body, by("qt-keepslid").checked ? by("qt-file").value : null);
    by("qt-slidsaid").textContent = `${used.in_use ? "The run goes on with these settings" : "A finished run stays as it is"}${used.file ? `; kept in ${used.file}` : ""}.`;
  } catch (error) {
    by("qt-slidsaid").textContent = error.message;
  }
});
