// A picture held still, to click in: by mouse, finger or keys; what is drawn on it is in its own pixels.
import { element } from "./format.js";

const SVG = new DOMParser().parseFromString("<svg></svg>", "text/html").body.firstChild.namespaceURI;
const STEP_PX = 10, ARROW_EVERY = 140;

export const svg = (tag, attributes, text) => {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (text !== undefined) made.textContent = text;
  return made;
};

export class Board {
  constructor(place, label, clicked) {
    this.clicked = clicked;
    this.image = element("img", { alt: "" });
    this.drawing = svg("svg", { tabindex: "0", role: "application", "aria-label": label });
    this.sheet = element("div", { class: "qt-sheet" }, this.image, this.drawing);
    this.window = element("div", { class: "qt-board" }, this.sheet);
    this.zooms = element("div", { class: "qt-zooms", role: "group", "aria-label": "Enlarge" });
    for (const zoom of [1, 2, 4]) {
      const button = element("button", { type: "button", "aria-pressed": `${zoom === 1}` }, `${zoom}×`);
      button.addEventListener("click", () => this.enlarge(zoom));
      this.zooms.append(button);
    }
    this.empty = element("p", { class: "qt-nopicture" }, "No picture");
    this.window.append(this.empty);
    place.replaceChildren(this.window, this.zooms);
    this.drawing.addEventListener("click", (event) => this.click(event));
    this.drawing.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.redraw()).observe(this.window);
    this.items = [];
    this.cross = null;
  }

  async hold(t_s) {
    const query = t_s === undefined ? "" : `?t_s=${t_s.toFixed(3)}`;
    const reply = await fetch(`/api/v1/still${query}`, { cache: "no-store" });
    if (!reply.ok) throw new Error((await reply.json()).detail);
    const still = await reply.json();
    this.image.src = `/api/v1/still/${still.number}/picture`;
    await this.image.decode().catch(() => {});
    this.still = still;
    this.drawing.setAttribute("viewBox", `0 0 ${still.width} ${still.height}`);
    this.sheet.style.aspectRatio = `${still.width} / ${still.height}`;
    this.empty.hidden = true;
    this.redraw();
    return still;
  }

  enlarge(zoom) {
    const { scrollWidth, scrollHeight, clientWidth, clientHeight } = this.window;
    const x = (this.window.scrollLeft + clientWidth / 2) / scrollWidth;
    const y = (this.window.scrollTop + clientHeight / 2) / scrollHeight;
    this.sheet.style.width = `${zoom * 100}%`;
    [...this.zooms.children].forEach((b) => b.setAttribute("aria-pressed", `${b.textContent === `${zoom}×`}`));
    this.window.scrollLeft = x * this.window.scrollWidth - clientWidth / 2;
    this.window.scrollTop = y * this.window.scrollHeight - clientHeight / 2;
    this.redraw();
  }

  click(event) {
    if (!this.still) return;
    const box = this.drawing.getBoundingClientRect();
    const u = ((event.clientX - box.left) / box.width) * this.still.width;
    const v = ((event.clientY - box.top) / box.height) * this.still.height;
    this.cross = null;
    this.clicked([Math.min(Math.max(u, 0), this.still.width), Math.min(Math.max(v, 0), this.still.height)]);
  }

  // The arrow keys move a cross, Enter clicks where it is; with Shift it moves by single pixels.
  key(event) {
    const way = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!this.still || (!way && event.key !== "Enter")) return;
    event.preventDefault();
    const { width, height } = this.still;
    this.cross ??= [width / 2, height / 2];
    if (!way) return this.clicked([...this.cross]);
    const step = event.shiftKey ? 1 : STEP_PX;
    this.cross = [Math.min(Math.max(this.cross[0] + way[0] * step, 0), width),
      Math.min(Math.max(this.cross[1] + way[1] * step, 0), height)];
    this.redraw();
  }

  // Items: {line: [[u, v], …], kind, arrows}, {point: [u, v], kind, text}
  draw(items) {
    this.items = items;
    this.redraw();
  }

  redraw() {
    if (!this.still) return;
    const scale = this.still.width / Math.max(this.sheet.clientWidth, 1);
    this.drawing.replaceChildren(...this.items.flatMap((item) => this.shapes(item, scale)));
    if (this.cross) {
      const [u, v] = this.cross, arm = 14 * scale;
      this.drawing.append(svg("path", { class: "qt-cross", d: `M${u - arm} ${v}H${u + arm}M${u} ${v - arm}V${v + arm}` }));
    }
  }

  shapes(item, scale) {
    if (item.line) {
      const found = [svg("polyline", { class: `qt-line qt-${item.kind}`, points: item.line.map((p) => p.join(",")).join(" ") })];
      if (item.arrows) found.push(...arrows(item.line, scale, item.kind));
      return found;
    }
    const [u, v] = item.point, found = [svg("circle", { class: `qt-dot qt-${item.kind}`, cx: u, cy: v, r: 5 * scale })];
    if (item.text) {
      found.push(svg("text", { class: "qt-label", x: u + 8 * scale, y: v - 8 * scale, "font-size": 15 * scale,
        "stroke-width": 4 * scale }, item.text));
    }
    return found;
  }
}

// One in the middle of the line, and more where it is long.
function arrows(line, scale, kind) {
  const found = [], every = ARROW_EVERY * scale, s = 11 * scale;
  const lengths = line.slice(1).map(([c, d], i) => Math.hypot(c - line[i][0], d - line[i][1]));
  const whole = lengths.reduce((a, b) => a + b, 0), count = Math.max(Math.floor(whole / every), 1);
  let passed = 0, next = whole / count / 2;
  lengths.forEach((length, i) => {
    for (; length > 0 && next <= passed + length; next += whole / count) {
      const [[a, b], [c, d]] = [line[i], line[i + 1]], share = (next - passed) / length;
      const [x, y] = [(c - a) / length, (d - b) / length], [u, v] = [a + (c - a) * share, b + (d - b) * share];
      const points = [[u + x * s, v + y * s], [u - x * s - y * s * 0.7, v - y * s + x * s * 0.7], [u - x * s + y * s * 0.7, v - y * s - x * s * 0.7]];
      found.push(svg("polygon", { class: `qt-arrow qt-${kind}`, points: points.map((p) => p.join(",")).join(" ") }));
    }
    passed += length;
  });
  return found;
}

// What the method knows of the road, drawn thinly below what the user draws.
export const lanesOf = (still) => (still?.drawing.lanes ?? []).map((lane) => ({ line: lane.px, kind: lane.dashed ? "lane" : "edge" }));

// Asks with a body; the server's own sentence where it refuses.
export async function send(path, body) {
  const reply = await fetch(path, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
  const found = await reply.json().catch(() => ({}));
  if (reply.ok) return found;
  const detail = Array.isArray(found.detail) ? `${found.detail[0].loc.slice(1).join(" ")}: ${found.detail[0].msg}` : found.detail;
  throw Object.assign(new Error(detail ?? `queuetail answered ${reply.status}`), { status: reply.status });
}

export async function get(path) {
  const reply = await fetch(path, { cache: "no-store" });
  const found = await reply.json().catch(() => ({}));
  if (reply.ok) return found;
  throw new Error(typeof found.detail === "string" ? found.detail : `queuetail answered ${reply.status}`);
}

// Saves with the user's consent, asked a second time where a file is there already.
export async function save(path, body, file) {
  try {
    return await send(path, { ...body, file, overwrite: false });
  } catch (error) {
    if (error.status !== 409 || !confirm(error.message)) throw error;
    return send(path, { ...body, file, overwrite: true });
  }
}

// "36.11306, -97.05883", "36.11306N 97.05883W" or 36°06'47.0"N 97°03'31.8"W; null for anything else.
export function place(text) {
  const parts = [...text.replaceAll("−", "-").matchAll(/(-?\d+(?:\.\d+)?)(?:\s*°\s*(?:(\d+(?:\.\d+)?)\s*['′]\s*)?(?:(\d+(?:\.\d+)?)\s*["″]\s*)?)?\s*([NSEW])?/gi)];
  if (parts.length !== 2) return null;
  const [lat, lon] = parts.map(([, degrees, minutes, seconds, side]) => {
    const size = Math.abs(Number(degrees)) + Number(minutes ?? 0) / 60 + Number(seconds ?? 0) / 3600;
    return degrees.startsWith("-") || /[SW]/i.test(side ?? "") ? -size : size;
  });
  return Math.abs(lat) <= 90 && Math.abs(lon) <= 180 ? [lat, lon] : null;
}
