// The answer in one glance: a word, a colour and a shape; numbers beside it.
import { NONE, M_PER_FT, distance, duration, element, fixed, plusMinus, units } from "./format.js";

const WORDS = { clear: "Clear", queued: "Queued", beyond_view: "Queue beyond view", unknown: "Unknown" };
const SHAPES = {
  clear: '<circle cx="24" cy="24" r="21"/><path class="m" d="M13 25l8 8 14-17"/>',
  queued: '<path d="M15 3h18l12 12v18L33 45H15L3 33V15z"/><path class="m" d="M12 24h24"/>',
  beyond_view: '<path d="M24 3l22 40H2z"/><path class="m" d="M24 36V19m-7 7l7-8 7 8"/>',
  unknown: '<rect x="5" y="5" width="38" height="38" rx="4" class="d"/><path class="m" d="M17 18c0-10 15-9 14 0-1 5-7 5-7 11m0 6v1"/>',
};
const STEADY_MPS = 0.05;
const tens = (value) => Math.max(Math.round(value / 10), 1) * 10;

function growth(mps) {
  if (mps === null) return ["Growth", NONE];
  if (Math.abs(mps) < STEADY_MPS) return ["Growth", "steady"];
  const per_min = Math.abs(mps) * 60; // in round tens: arrivals make the last digits flicker
  const amount = units() === "us" ? fixed(tens(per_min / M_PER_FT), 0, "ft/min") : fixed(tens(per_min), 0, "m/min");
  return [mps > 0 ? "Growing by" : "Shrinking by", amount];
}

export class Status {
  constructor(place, said) {
    this.place = place;
    this.said = said;
    this.state = null;
    this.late_s = null;
    this.cards = new Map();
  }

  take(state) {
    this.state = state;
    this.taken_ms = performance.now();
    this.show();
  }

  tick(late_s, connected) {
    const was = this.late_s !== null;
    this.late_s = late_s;
    this.connected = connected;
    if (late_s !== null || was) this.show();
    else this.age();
  }

  show() {
    const approaches = this.state?.approaches.length ? this.state.approaches
      : [{ approach: "", status: "unknown", reasons: ["there is no answer yet"], eoq: null, signs: [], taper_distance_m: null }];
    const names = new Set(approaches.map((a) => a.approach));
    for (const [name, card] of this.cards) if (!names.has(name)) { card.remove(); this.cards.delete(name); }
    for (const approach of approaches) this.card(approach);
    this.age();
    const text = approaches.map((a) => `${a.approach} ${this.word(a)}`).join(", ");
    if (this.said.textContent !== text) this.said.textContent = text;
  }

  word(approach) { return WORDS[this.late_s === null ? approach.status : "unknown"]; }

  reasons(approach) {
    if (this.late_s === null) return approach.reasons;
    const why = this.connected ? "no new answer" : "queuetail does not answer";
    return [`${why} for ${this.late_s.toFixed(0)} s`];
  }

  card(approach) {
    let card = this.cards.get(approach.approach);
    if (!card) {
      card = element("section", { class: "qt-card qt-answer" });
      this.cards.set(approach.approach, card);
      this.place.append(card);
    }
    const kind = this.late_s === null ? approach.status : "unknown";
    const head = element("div", { class: `qt-sign qt-${kind}` });
    head.innerHTML = `<svg viewBox="0 0 48 48" aria-hidden="true">${SHAPES[kind]}</svg>`;
    const words = element("div", {}, element("strong", {}, this.word(approach)));
    if (approach.approach) words.append(element("span", {}, approach.approach));
    head.append(words);
    card.dataset.status = kind;
    card.replaceChildren(head, ...this.why(approach), this.table(approach));
  }

  why(approach) {
    return this.reasons(approach).map((reason) => element("p", { class: "qt-reason" }, reason));
  }

  table(approach) {
    const eoq = this.late_s === null ? approach.eoq : null;
    const bound = approach.status === "beyond_view" ? "at least " : "";
    const rows = [];
    if (eoq) {
      for (const sign of approach.signs) {
        const inside = sign.distance_m < 0;
        rows.push([`${sign.name} ${inside ? "is in the queue by" : "to the queue"}`, distance(Math.abs(sign.distance_m)), "big"]);
        if (sign.reached_in_s !== null) rows.push([`Queue reaches ${sign.name} in`, duration(sign.reached_in_s), "big"]);
      }
      const taper_m = approach.taper_distance_m;
      if (taper_m !== null) rows.push([taper_m < 0 ? "Past the taper by" : "Queue's end to the taper", distance(Math.abs(taper_m)), "big"]);
      rows.push(["Queue length", bound + distance(eoq.length_m), "big"]);
      rows.push([...growth(eoq.growth_mps), "big"]);
      rows.push(["Vehicles queued", `${eoq.vehicles}`]);
      rows.push(["Station", plusMinus(eoq.station_m, eoq.sigma_m)]);
      if (eoq.lat_deg !== null) rows.push(["GPS", `${eoq.lat_deg.toFixed(6)}, ${eoq.lon_deg.toFixed(6)}`.replaceAll("-", "−"), "gps"]);
    } else {
      for (const sign of approach.signs) rows.push([`Sign ${sign.name}`, `at station ${distance(sign.station_m)}`]);
    }
    if (this.state?.live) rows.push(["Age of this answer", "", "age"]);
    return element("table", {}, ...rows.map(([name, value, kind]) =>
      element("tr", kind ? { class: `qt-${kind}` } : {}, element("th", { scope: "row" }, name), element("td", {}, value))));
  }

  age() {
    if (!this.state?.live) return;
    const age_s = (this.state.age_s ?? 0) + (performance.now() - this.taken_ms) / 1000;
    const text = this.state.age_s === null ? NONE : duration(age_s);
    for (const cell of this.place.querySelectorAll(".qt-age td")) if (cell.textContent !== text) cell.textContent = text;
  }
}
