// The entries of a legend become buttons that show and hide their series.
for (const figure of document.querySelectorAll("figure")) {
  const hidden = new Set();
  const entries = [...figure.querySelectorAll("li[data-key]")];
  for (const entry of entries) {
    const button = document.createElement("button");
    button.type = "button";
    button.setAttribute("aria-pressed", "true");
    button.append(...entry.childNodes);
    entry.append(button);
    button.addEventListener("click", () => {
      const { key } = entry.dataset;
      if (!hidden.delete(key)) hidden.add(key);
      for (const other of entries) {
        if (other.dataset.key !== key) continue;
        other.classList.toggle("off", hidden.has(key));
        other.firstChild.setAttribute("aria-pressed", String(!hidden.has(key)));
      }
      for (const series of figure.querySelectorAll("[data-keys]")) {
        const away = series.dataset.keys.split(" ").some((each) => hidden.has(each));
        series.classList.toggle("away", away);
      }
      hush();
      for (const svg of figure.querySelectorAll(".panels svg")) stopAt(svg);
    });
  }
}
