// The API's description, from openapi.json, without any outside part.
import { ask, element } from "./format.js";

const place = document.getElementById("docs");
const api = await ask("/openapi.json");
const resolve = (schema) => (schema?.$ref ? api.components.schemas[schema.$ref.split("/").pop()] : schema);

function type(schema) {
  if (!schema) return "";
  if (schema.$ref) return schema.$ref.split("/").pop();
  if (schema.anyOf) return schema.anyOf.map(type).join(" or ");
  if (schema.enum) return schema.enum.join(", ");
  if (schema.type === "array") return `list of ${type(schema.items)}`;
  return schema.format ?? schema.type ?? "anything";
}

const table = (head, rows) => element("div", { class: "qt-scroll", tabindex: "0" },
  element("table", { class: "qt-table" },
    element("thead", {}, element("tr", {}, ...head.map((h) => element("th", { scope: "col" }, h)))),
    element("tbody", {}, ...rows.map(([name, ...rest]) =>
      element("tr", {}, element("th", { scope: "row" }, element("code", {}, name)), ...rest.map((v) => element("td", {}, v)))))));

function limits(schema) {
  const parts = [];
  if (schema?.minimum !== undefined) parts.push(`from ${schema.minimum}`);
  if (schema?.maximum !== undefined) parts.push(`to ${schema.maximum}`);
  if (schema?.default !== undefined && schema.default !== null) parts.push(`default ${schema.default}`);
  return parts.join(", ");
}

for (const [path, methods] of Object.entries(api.paths)) {
  for (const [method, call] of Object.entries(methods)) {
    const card = element("section", { class: "qt-card qt-call" },
      element("h2", {}, element("code", {}, `${method.toUpperCase()} ${path}`)),
      element("p", {}, call.description ?? ""));
    if (call.parameters?.length)
      card.append(table(["parameter", "type", "limits", "meaning"], call.parameters.map((p) => {
        const plain = p.schema.anyOf?.find((s) => s.type !== "null") ?? p.schema;
        return [p.name, type(p.schema), limits({ ...plain, default: p.schema.default }), p.description ?? p.schema.description ?? ""];
      })));
    const answers = Object.entries(call.responses).map(([code, answer]) =>
      [code, Object.entries(answer.content ?? {}).map(([kind, c]) => `${kind} ${type(c.schema)}`).join(", "), answer.description]);
    card.append(table(["status", "content", "meaning"], answers));
    if (method === "get" && path.startsWith("/api")) card.append(element("p", {}, element("a", { href: path }, "Try it")));
    place.append(card);
  }
}
for (const [name, schema] of Object.entries(api.components?.schemas ?? {})) {
  if (!schema.properties) continue;
  place.append(element("section", { class: "qt-card qt-call" }, element("h2", {}, name),
    element("p", {}, schema.description ?? ""),
    table(["field", "type", "meaning"], Object.entries(schema.properties).map(([field, s]) => [field, type(s), resolve(s)?.description ?? ""]))));
}
