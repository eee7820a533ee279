// The day or night look: the system's, until the reader chooses; and the reader's units.
(() => {
  const root = document.documentElement;
  const system = matchMedia("(prefers-color-scheme: dark)");
  const chosen = () => localStorage.getItem("qt-theme");
  const apply = () => {
    const dark = (chosen() ?? (system.matches ? "dark" : "light")) === "dark";
    root.dataset.theme = dark ? "dark" : "light";
    window.Quasar?.Dark?.set(dark);
    document.dispatchEvent(new CustomEvent("qt-theme"));
  };
  apply();
  system.addEventListener("change", apply);
  addEventListener("load", apply);
  addEventListener("storage", apply);
  document.addEventListener("click", (event) => {
    if (!event.target.closest?.("#qt-theme")) return;
    localStorage.setItem("qt-theme", root.dataset.theme === "dark" ? "light" : "dark");
    apply();
  });
})();
