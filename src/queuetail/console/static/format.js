// Numbers as people read them; "–" where nothing is known.
export const NONE = "–";
export const MPS_PER_MPH = 0.44704, M_PER_FT = 0.3048;

// What the reader chose on Watch, else what the site's signs are in.
export const units = () => localStorage.getItem("qt-units")
  ?? document.querySelector("meta[name=qt-units]")?.content ?? "us";

export function fixed(value, digits = 0, unit = "") {
  if (value === null || value === undefined || !Number.isFinite(value)) return NONE;
  return `${value.toFixed(digits).replace("-", "−")}${unit && " " + unit}`;
}

export function distance(metres, digits = 0) {
  if (metres === null || metres === undefined) return NONE;
  return units() === "us" ? fixed(metres / M_PER_FT, digits, "ft") : fixed(metres, digits, "m");
}

// A place with how sure it is, both in the same unit: 2981 ± 1.8 ft.
export function plusMinus(metres, sigma_m) {
  return `${distance(metres).replace(/ .*/, "")} ± ${distance(Math.max(sigma_m, 0.1), sigma_m < 3 ? 1 : 0)}`;
}

export function speed(mps, digits = 0) {
  if (mps === null || mps === undefined) return NONE;
  return units() === "us" ? fixed(mps / MPS_PER_MPH, digits, "mph") : fixed(mps * 3.6, digits, "km/h");
}

export function duration(seconds) {
  if (seconds === null || seconds === undefined) return NONE;
  if (seconds < 10) return fixed(seconds, 1, "s");
  if (seconds < 120) return fixed(seconds, 0, "s");
  return seconds < 7200 ? fixed(seconds / 60, 0, "min") : fixed(seconds / 3600, 1, "h");
}

export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// What NiceGUI draws comes a moment after the scripts.
export async function appeared(id) {
  for (;;) {
    const found = document.getElementById(id);
    if (found) return found;
    await new Promise(requestAnimationFrame);
  }
}

export async function ask(path) {
  const reply = await fetch(path, { cache: "no-store", signal: AbortSignal.timeout(4000) });
  if (!reply.ok) throw new Error(`${path}: ${reply.status}`);
  return reply.json();
}
