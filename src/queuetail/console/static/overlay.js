// What is drawn over the picture: crisp at any size, each kind with its own colour and line.
import { plusMinus, speed, units } from "./format.js";

const KINDS = {
  moving: { colour: "#56c8ff", width: 1.6 },
  queued: { colour: "#ffb000", width: 2.6 },
  end: { colour: "#ff4f6d", width: 4 },
};
const TRAIL_S = 12;
const HALO = "rgba(0, 0, 0, .75)";

export class Overlay {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d");
    this.trails = new Map();
    this.layers = {};
    for (const box of document.querySelectorAll("[data-layer]")) {
      const key = `qt-layer-${box.dataset.layer}`;
      box.checked = localStorage.getItem(key) !== "off";
      this.layers[box.dataset.layer] = box.checked;
      box.addEventListener("change", () => {
        localStorage.setItem(key, box.checked ? "on" : "off");
        this.layers[box.dataset.layer] = box.checked;
        this.draw();
      });
    }
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  take(drawing, t_s) {
    if (drawing.epoch !== this.drawing?.epoch || t_s < this.t_s) this.trails.clear();
    this.drawing = drawing;
    this.t_s = t_s;
    this.remember();
    this.draw();
  }

  clear() {
    this.drawing = null;
    this.trails.clear();
    this.draw();
  }

  // Trails are kept in the reference picture, so that a drifting drone does not smear them.
  remember() {
    for (const [id, kind, , , , , , , u, v] of this.drawing.boxes) {
      if (u === null || v === null) continue;
      if (!this.trails.has(id)) this.trails.set(id, []);
      this.trails.get(id).push([this.t_s, kind, ...mapped(this.drawing.H_ref, u, v)]);
    }
    for (const [id, points] of this.trails) {
      while (points.length && points[0][0] < this.t_s - TRAIL_S) points.shift();
      if (!points.length) this.trails.delete(id);
    }
  }

  draw() {
    const { canvas, context: c } = this;
    const ratio = window.devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    if (!this.drawing?.size) return;
    this.scale = width / this.drawing.size[0];
    this.width = width;
    this.height = height;
    this.taken = [];
    c.lineJoin = "round";
    if (this.layers.lanes) this.drawLanes();
    if (this.layers.trails) this.drawTrails();
    if (this.layers.boxes) this.drawBoxes();
    if (this.layers.ends) this.drawEnds();
    if (this.layers.lanes) this.drawStations();
    if (this.layers.speeds) this.drawSpeeds();
    if (this.layers.boxes) this.drawLegend();
  }

  path(points, closed = false) {
    const c = this.context;
    c.beginPath();
    points.forEach(([u, v], i) => c[i ? "lineTo" : "moveTo"](u * this.scale, v * this.scale));
    if (closed) c.closePath();
  }

  drawLanes() {
    const c = this.context;
    for (const lane of this.drawing.lanes) {
      this.path(lane.px);
      c.setLineDash(lane.dashed ? [8, 8] : []);
      this.stroke("rgba(255, 255, 255, .85)", lane.dashed ? 1 : 1.4);
    }
    c.setLineDash([]);
  }

  drawStations() {
    const us = units() === "us";
    for (const tick of us ? this.drawing.ticks_ft : this.drawing.ticks) {
      this.path(tick.px);
      this.stroke("#fff", 1.6);
      const [u, v] = tick.px[1];
      this.label(`${tick.text} ${us ? "ft" : "m"}`, u * this.scale, v * this.scale, { size: 11, colour: "#fff", below: true });
    }
  }

  drawTrails() {
    const c = this.context, back = inverse(this.drawing.H_ref);
    if (!back) return;
    for (const points of this.trails.values()) {
      if (points.length < 2) continue;
      this.path(points.map(([, , x, y]) => mapped(back, x, y)));
      c.globalAlpha = 0.7;
      c.lineWidth = 1.5;
      c.strokeStyle = KINDS[points.at(-1)[1]].colour;
      c.stroke();
      c.globalAlpha = 1;
    }
  }

  drawBoxes() {
    const c = this.context, s = this.scale;
    for (const [, kind, coasting, x, y, w, h, , u, v] of this.drawing.boxes) {
      const { colour, width } = KINDS[kind];
      c.setLineDash(coasting ? [4, 4] : []);
      c.beginPath();
      if (x !== null && w > 0) c.rect(x * s, y * s, w * s, h * s);
      else if (u !== null) c.arc(u * s, v * s, 5, 0, 7);
      this.stroke(colour, width);
    }
    c.setLineDash([]);
  }

  drawEnds() {
    const c = this.context;
    for (const end of this.drawing.ends) {
      if (end.sigma.length === 2) {
        this.path([...end.sigma[0], ...end.sigma[1].slice().reverse()], true);
        c.fillStyle = "rgba(255, 79, 109, .4)";
        c.fill();
      }
      if (!end.bar) continue;
      this.path(end.bar);
      c.lineCap = "round";
      c.strokeStyle = "#fff";
      c.lineWidth = 8;
      c.stroke();
      c.strokeStyle = "#d4002a";
      c.lineWidth = 4.5;
      c.stroke();
      c.lineCap = "butt";
      const [u, v] = end.bar[0][1] < end.bar[1][1] ? end.bar[0] : end.bar[1];
      const words = `${end.beyond ? "queue ends upstream of" : "end of queue"} ${plusMinus(end.station_m, end.sigma_m)}`;
      this.label(words, u * this.scale, v * this.scale - 8, { size: 14, colour: "#fff", back: "#a80022", bold: true });
    }
  }

  drawSpeeds() {
    const s = this.scale, order = { end: 0, queued: 1, moving: 2 };
    const boxes = [...this.drawing.boxes].sort((a, b) => order[a[1]] - order[b[1]]);
    for (const [, kind, , x, y, w, h, mps, u, v] of boxes) {
      if (mps === null) continue;
      const left = x !== null ? (x + w / 2) * s : u * s, top = x !== null ? y * s : v * s - 6;
      const below = x !== null ? (y + h) * s : v * s + 6;
      const text = speed(Math.abs(mps));
      this.label(text, left, top - 3, { size: 12, colour: KINDS[kind].colour, or: below });
    }
  }

  drawLegend() {
    const c = this.context;
    let x = 10;
    const y = this.height - 10;
    c.font = "600 12px system-ui, sans-serif";
    for (const [kind, words] of [["moving", "moving"], ["queued", "queued"], ["end", "last in the queue"]]) {
      const width = c.measureText(words).width + 26;
      if (x + width > this.width) return;
      c.fillStyle = HALO;
      c.fillRect(x - 4, y - 14, width, 20);
      c.beginPath();
      c.rect(x, y - 9, 11, 9);
      this.stroke(KINDS[kind].colour, KINDS[kind].width);
      c.fillStyle = "#fff";
      c.fillText(words, x + 17, y);
      x += width + 6;
    }
  }

  stroke(colour, width) {
    const c = this.context;
    c.strokeStyle = HALO;
    c.lineWidth = width + 1.6;
    c.stroke();
    c.strokeStyle = colour;
    c.lineWidth = width;
    c.stroke();
  }

  // Text centred at x with its bottom at y, where nothing else is written; else below, else not.
  label(text, x, y, { size, colour, back = HALO, bold = false, below = false, or = null }) {
    const c = this.context;
    c.font = `${bold ? 700 : 600} ${size}px system-ui, sans-serif`;
    const width = c.measureText(text).width + 8, height = size + 5;
    const left = Math.min(Math.max(x - width / 2, 0), this.width - width);
    const tops = below ? [y] : or === null ? [y - height] : [y - height, or + 3];
    const top = tops.map((t) => Math.min(Math.max(t, 0), this.height - height)).find((t) => this.free(left, t, width, height));
    if (top === undefined) return;
    this.taken.push([left, top, width, height]);
    c.fillStyle = back;
    c.beginPath();
    c.roundRect(left, top, width, height, 3);
    c.fill();
    c.fillStyle = colour;
    c.textBaseline = "middle";
    c.fillText(text, left + 4, top + height / 2 + 0.5);
    c.textBaseline = "alphabetic";
  }

  free(x, y, w, h) {
    return !this.taken.some(([a, b, c, d]) => x < a + c && a < x + w && y < b + d && b < y + h);
  }
}

function mapped(H, x, y) {
  const w = H[6] * x + H[7] * y + H[8];
  return [(H[0] * x + H[1] * y + H[2]) / w, (H[3] * x + H[4] * y + H[5]) / w];
}

function inverse([a, b, c, d, e, f, g, h, i]) {
  const A = e * i - f * h, B = f * g - d * i, C = d * h - e * g, det = a * A + b * B + c * C;
  if (!det) return null;
  return [A, c * h - b * i, b * f - c * e, B, a * i - c * g, c * d - a * f, C, b * g - a * h, a * e - b * d].map((v) => v / det);
}
