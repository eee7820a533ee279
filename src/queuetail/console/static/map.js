// The map: the drone's own picture laid flat as the base, and everything of the API drawn on it.
import { ask, units, distance } from "./format.js";

const EVERY_MS = 1000, BASE_EVERY_MS = 4000;
const STYLES = {
  view: { color: "#1668c7", weight: 2, fill: false, dashArray: "4 4" },
  axis: { color: "#ffffff", weight: 2 }, edge: { color: "#ffffff", weight: 1 },
};

export class MapView {
  constructor(player) {
    this.player = player;
    this.place = document.getElementById("qt-map");
    this.note = document.getElementById("qt-mapnote");
  }

  async start() {
    const sheet = document.createElement("link");
    Object.assign(sheet, { rel: "stylesheet", href: "/static/leaflet/leaflet/leaflet.css" });
    document.head.append(sheet);
    const { leaflet: L } = await import("/static/leaflet/index.js");
    this.L = L;
    this.map = L.map(this.place, { attributionControl: false, zoomSnap: 0.25, maxZoom: 24, zoomAnimation: false });
    this.map.setView([0, 0], 2);
    L.control.scale({ imperial: units() === "us", metric: units() !== "us" }).addTo(this.map);
    this.layer = L.layerGroup().addTo(this.map);
    new ResizeObserver(() => this.map.invalidateSize()).observe(this.place);
    this.round(() => this.features(), EVERY_MS);
    this.round(() => this.base(), BASE_EVERY_MS);
  }

  // Ask again and again, but not while nobody looks, nor before the last answer came.
  async round(call, pause_ms) {
    for (;;) {
      if (!document.hidden) await call().catch(() => {});
      await new Promise((wake) => setTimeout(wake, pause_ms));
    }
  }

  get moment() { return this.player ? `?t_s=${this.player.t_s.toFixed(2)}` : ""; }

  async features() {
    const { features } = await ask(`/api/v1/map${this.moment}`);
    const drawn = features.length > 0;
    this.note.textContent = drawn ? "" : "The place of the picture is not known now.";
    if (!drawn) return;
    const L = this.L, layers = [];
    for (const f of features) {
      const p = f.properties, at = f.geometry.coordinates;
      const point = f.geometry.type === "Point" ? [at[1], at[0]] : null;
      if (p.kind === "past") layers.push(L.circleMarker(point, { radius: 2.5, stroke: false, fillColor: "#ff4f6d", fillOpacity: .6 }));
      else if (p.kind === "eoq") layers.push(this.sign(point, "eoq", "■", `End of queue ${p.approach}, ± ${distance(p.sigma_m)}`));
      else if (p.kind === "sign") layers.push(this.sign(point, "sign", "◆", `Sign ${p.name}`));
      else if (p.kind === "drone") layers.push(this.sign(point, "drone", `<span style="transform:rotate(${p.heading_deg}deg)">▲</span>`, `Drone, ${distance(p.height_agl_m)} above ground`));
      else layers.push(L.geoJSON(f, { style: STYLES[p.kind] ?? STYLES.edge, interactive: false }));
    }
    this.layer.clearLayers();
    layers.forEach((layer) => layer.addTo(this.layer));
    if (!this.fitted) {
      this.fitted = true;
      // Without a picture in view the whole road is shown: the end of the queue alone is but a point.
      const near = features.filter((f) => ["view", "drone", "eoq"].includes(f.properties.kind));
      const bounds = L.geoJSON(near.some((f) => f.properties.kind === "view") ? near : features).getBounds();
      this.map.fitBounds(bounds, { animate: false, padding: [8, 8] });
    }
  }

  sign(point, kind, html, title) {
    const icon = this.L.divIcon({ className: `qt-pin qt-pin-${kind}`, html, iconSize: [26, 26] });
    return this.L.marker(point, { icon, title, alt: title, keyboard: false })
      .bindTooltip(title);
  }

  async base() {
    const reply = await fetch(`/api/v1/map/picture${this.moment}`, { cache: "no-store" });
    if (!reply.ok) return;
    const [south, west, north, east] = reply.headers.get("X-Bounds").split(",").map(Number);
    const url = URL.createObjectURL(await reply.blob());
    const bounds = [[south, west], [north, east]];
    const fresh = this.L.imageOverlay(url, bounds, { interactive: false, alt: "The drone's picture laid flat" });
    fresh.once("load", () => {
      this.picture?.remove();
      if (this.url) URL.revokeObjectURL(this.url);
      this.picture = fresh;
      this.url = url;
    });
    fresh.addTo(this.map);
  }
}
