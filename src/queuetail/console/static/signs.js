// The Signs screen: every sign once a second; one dialog to arm, one click to disarm.
import { appeared, ask, distance, duration, element } from "./format.js";

const LATE_S = 2.0, WHO = "qt-who";
const root = await appeared("qt-signs");
const by = (id) => document.getElementById(id);
const list = by("qt-list"), control = by("qt-control"), said = by("qt-said");
const arm = by("qt-arm"), disarm = by("qt-disarm"), dialog = by("qt-ask");
let heard_s = performance.now() / 1000, before = "";

const DOES = {
  default: "Nothing is known: its default", clear: "No queue ahead", warning: "Warns with the distance",
  ahead: "Warns of a queue close ahead or beyond the picture", passed: "The queue reaches the sign or has passed it",
  caution: "The answer is unknown or old: a cautious message",
};
const words = (phases) => phases.map((lines) => lines.join(" ")).join(" | ") || "blank";
const row = (name, value) => element("tr", {}, element("th", { scope: "row" }, name), element("td", {}, value));

function faces(sign, number, shown) {
  const phases = shown ? sign.shown : sign.phases;
  const count = Math.max(phases.length, 1);
  return element("div", { class: "qt-faces" }, ...[...Array(count).keys()].map((index) => picture(
    `/api/v1/signs/${number}/face.png?phase=${index + 1}&shown=${shown}&of=${encodeURIComponent(words(phases))}`,
    `Phase ${index + 1}: ${phases[index]?.join(" ") || "blank"}`)));
}

// The same picture stays while the cards around it are made anew; what is not shown is forgotten.
let kept = new Map(), used = new Map();
function picture(src, alt) {
  const found = kept.get(src) ?? element("img", { src, alt, width: "520", height: "290" });
  used.set(src, found);
  return found;
}

const figure = (caption, content) => element("figure", {}, element("figcaption", {}, caption), content);

function place(sign) {
  const at = sign.place;
  if (!at) return [];
  if (at.fit === "ok") return [row("where it stands", "well")];
  const way = `${at.fit === "too_close" ? "too close" : "too far"}: move it ${distance(Math.abs(at.move_m))} ${at.move_m > 0 ? "upstream" : "downstream"}`;
  const to = at.move_to ? `, to ${at.move_to.map((v) => v.toFixed(6)).join(", ")}` : "";
  return [row("where it stands", `⚠ ${way}${at.move_to_station_m === null ? "" : `, to station ${at.move_to_station_m.toFixed(0)} m`}${to}`)];
}

function card(sign, number) {
  const told = sign.shown !== null;
  const silent = sign.delivery === "retrying" || sign.delivery === "failed";
  const differs = told && JSON.stringify(sign.shown) !== JSON.stringify(sign.phases);
  const mark = silent ? "? Not known now. It told" : sign.delivery === "off" ? "When control ended it showed," : `${differs ? "≠" : "✓"} Shows, by its own word`;
  const should = sign.kind === "beacon" ? element("p", { class: "qt-does" }, sign.beacon ? "Beacons flash" : "Beacons off")
    : figure(`Should show: ${words(sign.phases)}`, faces(sign, number, false));
  return element("section", { class: "qt-card", "data-sign": sign.name, "data-state": sign.state ?? "" },
    element("h2", {}, sign.name),
    element("p", { class: "qt-does" }, DOES[sign.state] ?? "No decision yet"),
    should,
    ...(told ? [figure(`${mark} ${duration(sign.shown_age_s)} ago: ${words(sign.shown)}`,
      differs && sign.delivery === "ok" ? faces(sign, number, true) : "")] : []),
    element("table", {},
      sign.distance_m < 0 ? row("the queue reaches", `${distance(-sign.distance_m)} past it`) : row("to the queue", distance(sign.distance_m)),
      row("distance asked for", distance(sign.required_m)),
      row("queue passes it in", sign.passes_in_s === null ? "–" : `about ${duration(sign.passes_in_s)}`),
      ...place(sign),
      row("control", sign.is_controlled ? (sign.delivery === "off" ? "not armed" : sign.delivery) : "advice only"),
      ...(sign.last_error ? [row("last error", `⚠ ${sign.last_error}`)] : [])),
    element("ul", { "aria-label": "Reasons" }, ...sign.reasons.map((reason) => element("li", {}, reason))));
}

function show(now) {
  const { control: state, signs } = now;
  const on = state?.armed ?? false;
  control.classList.toggle("qt-on", on);
  control.dataset.armed = on;
  const since = state?.since_utc ? new Date(state.since_utc).toLocaleString() : "";
  let about = state === null ? "This run has no signs: a live run with [[sign]] in its site file has."
    : on ? `queuetail controls the signs on the word of ${state.who}, since ${since}` : `${state.reason}${state.who ? `, by ${state.who}` : ""}, ${since}`;
  if (state && !now.can_arm) about = "Advice only: no sign has an address.";
  if (now.dry_run) about = `Dry run: nothing is sent. ${about}`;
  if (now.is_outdated) about += " ⚠ The settings name other signs now: they count from the next start of queuetail live.";
  by("qt-armed").firstElementChild.textContent = on ? "▶ Armed" : "■ Not armed";
  by("qt-armed").lastElementChild.textContent = about;
  if (arm) {
    arm.hidden = on || state === null;
    arm.disabled = !now.can_arm;
    disarm.hidden = !on;
    by("qt-which").textContent = signs.filter((s) => s.is_controlled).map((s) => s.name).join(", ") || "no sign (dry run)";
  }
  const stable = JSON.stringify(signs.map((s) => ({ ...s, shown_age_s: Math.round(s.shown_age_s), passes_in_s: Math.round(s.passes_in_s) })));
  if (stable === before) return;
  before = stable;
  used = new Map();
  list.replaceChildren(...signs.map((sign, index) => card(sign, index + 1)));
  kept = used;
}

function say(sentence) {
  said.textContent = sentence;
  said.hidden = !sentence;
}

async function change(body) {
  try {
    const reply = await fetch("/api/v1/signs/arming", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body), signal: AbortSignal.timeout(4000),
    });
    const answer = await reply.json();
    say(reply.ok ? "" : `⚠ ${answer.detail?.[0]?.msg ?? answer.detail}`);
    show(await ask("/api/v1/signs"));
  } catch {
    say(body.armed ? "⚠ Not armed: queuetail does not answer." : "⚠ Not sure to be disarmed: queuetail does not answer.");
  }
}

arm?.addEventListener("click", () => {
  by("qt-who").value = localStorage.getItem(WHO) ?? "";
  dialog.showModal();
});
by("qt-no")?.addEventListener("click", () => dialog.close());
by("qt-askform")?.addEventListener("submit", () => {
  const who = by("qt-who").value.trim();
  localStorage.setItem(WHO, who);
  change({ armed: true, who });
});
disarm?.addEventListener("click", () => change({ armed: false, who: localStorage.getItem(WHO) ?? "" }));

async function refresh() {
  try {
    show(await ask("/api/v1/signs"));
    heard_s = performance.now() / 1000;
    if (root.classList.contains("qt-stale-all")) say("");
    root.classList.remove("qt-stale-all");
    list.classList.remove("qt-stale");
  } catch {
    if (performance.now() / 1000 - heard_s > LATE_S) {
      say("⚠ queuetail does not answer: what is shown below is old. Signs go to their defaults by themselves.");
      root.classList.add("qt-stale-all");
      list.classList.add("qt-stale");
    }
  }
  setTimeout(refresh, 1000);
}
refresh();
