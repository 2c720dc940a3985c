// A drag along an axis of time shows that part of it, in all panels that share it; so do
// plus, minus and the arrows, and 0 or a double click shows all of it again.
const POINT = /([ML])(-?[\d.]+) (-?[\d.]+)/g; // marks are drawn from theirs with steps
const between = (a, b, share) => a + share * (b - a);
const within = (a, b, x) => Math.min(b, Math.max(a, x));
function evenly(low, high, most) { // round numbers, at most so many
  const least = (high - low) / most, power = 10 ** Math.floor(Math.log10(least)), found = [];
  const step = power * [1, 2, 2.5, 5, 10].find((factor) => factor * power >= least * (1 - 1e-9));
  for (let k = Math.ceil(low / step - 1e-9); k <= high / step + 1e-9; k++) found.push(Number((k * step).toPrecision(9)));
  return found;
}

for (const svg of document.querySelectorAll("svg.long")) {
  const sheets = [...svg.querySelectorAll("[data-axes]")].map((sheet) => ({
    ends: sheet.dataset.axes.split(" ").map(Number),
    axes: [...sheet.querySelectorAll("g.x, g.y")].map((axis) => [axis, axis.innerHTML]),
    ink: [...sheet.querySelectorAll("g[clip-path] path")].map((path) => [path, path.getAttribute("d")]),
  }));
  const [left, , right] = sheets[0].ends;
  let [start, width, from] = [0, 1, null]; // what is seen of the axis; where a drag began

  function rule(axis, [, top, , foot], low, high) { // its lines and names for these values
    const flat = axis.matches(".x"), [grid, strokes] = axis.querySelectorAll("path");
    const names = [...axis.querySelectorAll("text")].filter((text) => !flat || text.getAttribute("text-anchor") === "middle");
    let [across, along] = ["", `M${left} ${foot}${flat ? `H${right}` : `V${top}`}`];
    for (const value of evenly(low, high, flat ? 6 : 4)) {
      const at = between(...(flat ? [left, right] : [foot, top]), (value - low) / (high - low)).toFixed(1);
      across += flat ? `M${at} ${foot}V${top}` : `M${left} ${at}H${right}`;
      along += flat ? `M${at} ${foot}v3` : `M${left} ${at}h-3`;
      if (!names.length) continue;
      const name = axis.appendChild(names[0].cloneNode());
      name.setAttribute(flat ? "x" : "y", flat ? at : Number(at) + 3.6);
      name.textContent = String(value).replace("-", "−");
    }
    grid.setAttribute("d", across);
    strokes.setAttribute("d", along);
    for (const name of names) name.remove();
  }

  function show(a, b) { // a part of the axis, no less than a thousandth of it
    width = within(1e-3, 1, b - a);
    start = within(0, 1 - width, a);
    const across = (x) => between(left, right, ((x - left) / (right - left) - start) / width);
    for (const { ends, axes, ink } of sheets) {
      const [, top, , foot, low, high, least, most] = ends;
      const even = width < 1 && least !== undefined; // the axis of a logarithm stays
      const seen = ink.filter(([path]) => even && path.parentNode.dataset.keys && path.checkVisibility())
        .flatMap(([, d]) => [...d.matchAll(POINT)]).filter(([, , x]) => across(x) >= left && across(x) <= right)
        .map((point) => Number(point[3]));
      const [up, down] = seen.length ? [Math.min(...seen), Math.max(...seen)] : [top, foot];
      const edge = seen.length && Math.max((down - up) / 20, (foot - top) / 1000);
      const to = (y) => between(top, foot, (y - up + edge) / (down - up + 2 * edge));
      for (const [path, d] of ink) {
        path.setAttribute("d", width === 1 ? d : d.replace(POINT, (_, letter, x, y) => `${letter}${across(x).toFixed(1)} ${to(y).toFixed(1)}`));
      }
      const value = (y) => between(most, least, (y - top) / (foot - top));
      for (const [axis, before] of axes) {
        axis.innerHTML = before;
        if (width < 1 && axis.matches(".x")) rule(axis, ends, between(low, high, start), between(low, high, start + width));
        else if (even) rule(axis, ends, value(down + edge), value(up - edge));
      }
    }
    svg.classList.toggle("zoomed", width < 1);
    back.hidden = width === 1;
    hush();
  }

  const shade = document.createElementNS("http://www.w3.org/2000/svg", "rect");
  shade.setAttribute("class", "chosen");
  shade.setAttribute("height", "100%");
  const place = (event) => { // of the pointer along the axis
    const { x, width: wide } = svg.getBoundingClientRect();
    return within(0, 1, ((event.clientX - x) / wide * svg.viewBox.baseVal.width - left) / (right - left));
  };
  svg.addEventListener("pointerdown", (event) => {
    if (event.button || event.pointerType === "touch") return;
    from = place(event);
    svg.setPointerCapture(event.pointerId);
  });
  for (const kind of ["pointermove", "pointerup"]) {
    svg.addEventListener(kind, (event) => {
      if (from === null) return;
      const [a, b] = [from, place(event)].sort((one, other) => one - other);
      shade.setAttribute("x", between(left, right, a));
      shade.setAttribute("width", (b - a) * (right - left));
      svg.append(shade);
      if (kind === "pointermove") return;
      from = null;
      shade.remove();
      if (b - a > 0.01) show(start + a * width, start + b * width);
    });
  }
  svg.addEventListener("dblclick", () => show(0, 1));
  svg.addEventListener("keydown", (event) => {
    const [a, b, step] = [start, start + width, width / 4];
    const to = { "+": [a + step, b - step], "=": [a + step, b - step], "-": [a - 2 * step, b + 2 * step],
      ArrowLeft: [a - step, b - step], ArrowRight: [a + step, b + step], 0: [0, 1] }[event.key];
    if (!to || event.target !== svg || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    show(...to);
  });
  const back = document.createElement("button");
  Object.assign(back, { type: "button", hidden: true, textContent: "Show all", onclick: () => show(0, 1) });
  svg.closest("figure").querySelector(".tools").prepend(back);
  svg.tabIndex = 0;
  svg.setAttribute("aria-label", `${svg.getAttribute("aria-label")}. To see a part of it: drag along the axis, or press plus, minus, the arrows and 0.`);
}
