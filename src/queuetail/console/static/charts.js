// Two charts on canvas: where the queue ended, and where every vehicle was, over time.
import { M_PER_FT, MPS_PER_MPH, ask, element, fixed, units } from "./format.js";

const EVERY_MS = 2000, WINDOW_S = 300, LEFT = 58, RIGHT = 10, TOP = 10, BOTTOM = 20;
const COLOURS = ["#e0304f", "#2f80d8", "#a8741a", "#9a4fd0"];
// From standing to free: dark red to light blue, which differ in brightness, too.
const SPEEDS = [[0.5, "#d0243c"], [2, "#e8590c"], [6, "#f2b134"], [12, "#8fb8de"], [1e9, "#3d7fc1"]];

export class Charts {
  constructor(about, player) {
    this.about = about;
    this.player = player;
    this.eoq = document.getElementById("qt-eoq");
    this.space = document.getElementById("qt-paths");
    this.rows = [];
    this.paths = null;
    for (const canvas of [this.eoq, this.space]) new ResizeObserver(() => this.draw()).observe(canvas);
    document.addEventListener("qt-theme", () => this.draw());
    document.addEventListener("qt-units", () => this.draw());
    if (player) for (const canvas of [this.eoq, this.space])
      canvas.addEventListener("click", (event) => {
        const share = (event.offsetX - LEFT) / (canvas.clientWidth - LEFT - RIGHT);
        const [low, high] = this.span;
        player.seek(Math.min(Math.max(low + share * (high - low), about.start_s), about.end_s));
      });
  }

  async start() {
    for (;;) {
      if (!document.hidden) await this.refresh().catch(() => {});
      await new Promise((wake) => setTimeout(wake, this.player ? 200 : EVERY_MS));
    }
  }

  async refresh() {
    if (this.player) {
      if (!this.paths) await this.fetch(this.about.start_s, this.about.end_s);
    } else {
      const { t_s } = await ask("/api/v1/state");
      if (t_s === null) return;
      await this.fetch(Math.max(t_s - WINDOW_S, 0), t_s);
    }
    this.draw();
  }

  async fetch(since_s, until_s) {
    const range = `since_s=${since_s.toFixed(2)}&until_s=${until_s.toFixed(2)}`;
    const [history, paths] = await Promise.all([
      ask(`/api/v1/history?${range}&limit=3000`), ask(`/api/v1/paths?${range}`)]);
    this.rows = history.rows;
    this.paths = paths;
    this.span = [since_s, Math.max(until_s, since_s + 30)];
  }

  draw() {
    if (!this.span) return;
    const known = this.rows.filter((r) => r.station_m !== null).flatMap((r) => [r.station_m - r.sigma_m, r.station_m + r.sigma_m]);
    const seen = this.paths?.station_m ?? [];
    const all = range(seen.length ? [...range(seen), ...known] : known);
    this.drawEoq(new Plot(this.eoq, this.span, known.length ? widened(range(known), 20) : widened(all, 10)));
    this.drawPaths(new Plot(this.space, this.span, widened(all, 10)));
  }

  drawEoq(plot) {
    const c = plot.context;
    const names = [...new Set(this.rows.map((r) => r.approach))].filter((n) => n); // none: no road known yet
    plot.unknown(this.rows.filter((r) => r.status === "unknown").map((r) => r.t_s), this.step);
    names.forEach((name, i) => {
      const colour = COLOURS[i % COLOURS.length];
      for (const part of parts(this.rows.filter((r) => r.approach === name))) {
        c.beginPath();
        part.forEach((r, k) => c[k ? "lineTo" : "moveTo"](plot.x(r.t_s), plot.y(r.station_m + r.sigma_m)));
        part.slice().reverse().forEach((r) => c.lineTo(plot.x(r.t_s), plot.y(r.station_m - r.sigma_m)));
        c.globalAlpha = 0.3;
        c.fillStyle = colour;
        c.fill();
        c.globalAlpha = 1;
        c.beginPath();
        part.forEach((r, k) => c[k ? "lineTo" : "moveTo"](plot.x(r.t_s), plot.y(r.station_m)));
        c.strokeStyle = colour;
        c.lineWidth = 2;
        c.stroke();
      }
    });
    plot.axes();
    if (!this.rows.some((r) => r.station_m !== null)) plot.say("no queue in this time");
    plot.legend([...names.map((n, i) => [COLOURS[i % COLOURS.length], `${n} ± sigma`]), ["hatch", "unknown"]]);
    this.cursor(plot);
  }

  drawPaths(plot) {
    const c = plot.context, { t_s, station_m, speed_mps } = this.paths ?? { t_s: [] };
    for (let i = 0; i < t_s.length; i += 1) {
      const v = Math.abs(speed_mps[i]);
      c.fillStyle = SPEEDS.find(([limit], k) => v <= limit || k === SPEEDS.length - 1)[1];
      c.fillRect(plot.x(t_s[i]) - 1, plot.y(station_m[i]) - 1, 2.4, 2.4);
    }
    c.fillStyle = plot.ink;
    for (const r of this.rows) if (r.station_m !== null) c.fillRect(plot.x(r.t_s) - 1, plot.y(r.station_m) - 1, 2, 2);
    plot.axes();
    const shown = (mps) => (units() === "us" ? fixed(mps / MPS_PER_MPH, 0) : fixed(mps * 3.6, 0));
    const unit = units() === "us" ? "mph" : "km/h";
    plot.legend([[SPEEDS[0][1], "standing"], [SPEEDS[2][1], `${shown(4)} ${unit}`], [SPEEDS[4][1], `over ${shown(12)} ${unit}`], [plot.ink, "end of queue"]]);
    this.cursor(plot);
  }

  cursor(plot) {
    if (!this.player) return;
    const x = plot.x(this.player.t_s), c = plot.context;
    c.strokeStyle = plot.ink;
    c.lineWidth = 1.5;
    c.beginPath();
    c.moveTo(x, TOP);
    c.lineTo(x, plot.height - BOTTOM);
    c.stroke();
  }
}

// One chart's frame: time to the right, stations downstream upwards.
class Plot {
  constructor(canvas, [t0, t1], [s0, s1]) {
    const ratio = window.devicePixelRatio || 1;
    this.width = canvas.clientWidth;
    this.height = canvas.clientHeight;
    canvas.width = Math.round(this.width * ratio);
    canvas.height = Math.round(this.height * ratio);
    const c = (this.context = canvas.getContext("2d"));
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    const style = getComputedStyle(document.documentElement);
    this.ink = style.getPropertyValue("--ink").trim();
    this.dim = style.getPropertyValue("--dim").trim();
    this.line = style.getPropertyValue("--line").trim();
    this.card = style.getPropertyValue("--card").trim();
    Object.assign(this, { t0, t1, s0, s1 });
    this.unit_m = units() === "us" ? M_PER_FT : 1;
    this.stations = ticks(s0 / this.unit_m, s1 / this.unit_m, 5).map((s) => s * this.unit_m);
    this.canvas = canvas;
    c.font = "12px system-ui, sans-serif";
    c.strokeStyle = this.line;
    c.lineWidth = 1;
    for (const s of this.stations) { c.beginPath(); c.moveTo(LEFT, this.y(s)); c.lineTo(this.width - RIGHT, this.y(s)); c.stroke(); }
    c.save();
    c.beginPath();
    c.rect(LEFT, 0, this.width - LEFT - RIGHT, this.height - BOTTOM);
    c.clip();
  }

  x(t_s) { return LEFT + ((t_s - this.t0) / (this.t1 - this.t0)) * (this.width - LEFT - RIGHT); }

  y(s) { return TOP + ((this.s1 - s) / (this.s1 - this.s0)) * (this.height - TOP - BOTTOM); }

  // Times without an answer are hatched: they are not times without a queue.
  unknown(times) {
    const c = this.context;
    c.strokeStyle = this.dim;
    c.globalAlpha = 0.5;
    for (const t of times) {
      const x = this.x(t);
      c.beginPath();
      c.moveTo(x - 2, this.height - BOTTOM);
      c.lineTo(x + 2, this.height - BOTTOM - 10);
      c.stroke();
    }
    c.globalAlpha = 1;
  }

  axes() {
    const c = this.context;
    c.restore();
    c.fillStyle = this.dim;
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (const s of this.stations) c.fillText(fixed(s / this.unit_m, 0, this.unit_m === 1 ? "m" : "ft"), LEFT - 6, this.y(s));
    c.textAlign = "center";
    c.textBaseline = "top";
    for (const t of ticks(this.t0, this.t1, Math.max(this.width / 110, 2), true)) {
      const text = `${Math.floor(t / 60)}:${String(Math.round(t % 60)).padStart(2, "0")}`;
      c.fillText(text, Math.min(this.x(t), this.width - 16), this.height - BOTTOM + 4);
    }
    c.textAlign = "left";
  }

  say(words) {
    const c = this.context;
    c.fillStyle = this.dim;
    c.textAlign = "center";
    c.fillText(words, this.width / 2, this.height / 2 - BOTTOM / 2);
    c.textAlign = "left";
  }

  // Below the canvas, where it wraps on a phone and grows with the reader's letters.
  legend(entries) {
    let list = this.canvas.nextElementSibling;
    if (!list) this.canvas.after(list = element("p", { class: "qt-legend" }));
    const key = JSON.stringify(entries);
    if (list.dataset.key === key) return;
    list.dataset.key = key;
    list.replaceChildren(...entries.map(([colour, words]) => element("span", {},
      element("i", colour === "hatch" ? { class: "qt-hatch" } : { style: `background:${colour}` }), words)));
  }
}

function range(values) {
  let low = Infinity, high = -Infinity;
  for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
  return low > high ? [0, 100] : [low, high];
}

function widened([low, high], by) { return [low - by, high + by]; }

function ticks(low, high, count, isTime = false) {
  const steps = isTime ? [1, 5, 10, 15, 30, 60, 120, 300, 600, 1800, 3600] : [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000];
  const step = steps.find((s) => (high - low) / s <= count) ?? steps.at(-1);
  const found = [];
  for (let v = Math.ceil(low / step) * step; v <= high; v += step) found.push(v);
  return found;
}

// Runs of rows with a station, broken where there is none or time jumps.
function parts(rows) {
  const found = [];
  let part = [];
  const limit_s = 3 * median(rows.slice(1).map((r, i) => r.t_s - rows[i].t_s)) + 0.5;
  for (const r of rows) {
    const broken = r.station_m === null || (part.length && r.t_s - part.at(-1).t_s > limit_s);
    if (broken && part.length) { found.push(part); part = []; }
    if (r.station_m !== null) part.push(r);
  }
  if (part.length) found.push(part);
  return found;
}

function median(values) {
  return values.length ? [...values].sort((a, b) => a - b)[values.length >> 1] : 1;
}
