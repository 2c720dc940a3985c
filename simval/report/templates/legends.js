// The entries of a legend become buttons that show and hide their series.
for (const figure of document.querySelectorAll("figure svg")) {
  const entries = new Map();
  for (const part of figure.querySelectorAll("[data-key]")) {
    entries.set(part.dataset.key, [...(entries.get(part.dataset.key) ?? []), part]);
  }
  const hidden = new Set();
  for (const [key, parts] of entries) {
    const button = parts.find((part) => part.querySelector("text"));
    if (!button) continue;
    button.setAttribute("role", "button");
    button.style.pointerEvents = "bounding-box"; // of SVG 2, which HTML checkers do not know
    button.setAttribute("tabindex", "0");
    button.setAttribute("aria-pressed", "true");
    figure.append(button); // an image has no buttons inside
    const toggle = () => {
      if (!hidden.delete(key)) hidden.add(key);
      button.setAttribute("aria-pressed", String(!hidden.has(key)));
      for (const part of parts) part.classList.toggle("off", hidden.has(key));
      for (const series of figure.querySelectorAll("[data-keys]")) {
        const away = series.dataset.keys.split(" ").some((each) => hidden.has(each));
        series.classList.toggle("away", away);
      }
      hush();
      stopAt(figure);
    };
    for (const part of parts) part.addEventListener("click", toggle);
    button.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      toggle();
    });
  }
}
