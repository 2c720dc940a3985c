// The box of text of a point: by pointer, touch and keyboard, closed by Escape.
const box = document.createElement("div");
box.className = "note";
box.setAttribute("role", "tooltip");
box.hidden = true;
document.body.append(box);
const notes = new Map(); // lines of text of each point
let told = null; // the point whose text is shown
let leaving = 0;

function place() { // beside its point, where it covers the fewest others
  if (!told) return;
  const at = told.getBoundingClientRect();
  const [wide, high, page] = [box.offsetWidth, box.offsetHeight, document.documentElement.clientWidth];
  const over = Math.max(8, Math.min(at.left + (at.width - wide) / 2, page - wide - 8));
  const spots = [[over, at.bottom + 2], [over, at.top - high - 2], [at.right + 2, at.top], [at.left - wide - 2, at.top]];
  const others = [...told.closest("svg").querySelectorAll(".points:not(.away) circle")]
    .map((other) => other.getBoundingClientRect());
  const cost = ([x, y]) => (x < 0 || x + wide > page || y < 0 || y + high > window.innerHeight ? 1e6 : 0)
    + others.filter((o) => o.right > x && o.left < x + wide && o.bottom > y && o.top < y + high).length;
  const [left, top] = spots.reduce((a, b) => (cost(b) < cost(a) ? b : a));
  box.style.left = `${left + window.scrollX}px`;
  box.style.top = `${top + window.scrollY}px`;
}

function hush() {
  clearTimeout(leaving);
  told?.classList.remove("told");
  told = null;
  box.hidden = true;
}

function tell(point) {
  clearTimeout(leaving);
  if (told === point) return;
  hush();
  told = point;
  point.classList.add("told");
  box.replaceChildren(...notes.get(point).map((line) => {
    const part = document.createElement(line.startsWith("simval ") ? "code" : "p");
    part.textContent = line;
    return part;
  }));
  box.hidden = false;
  place();
}

function leave() {
  clearTimeout(leaving);
  leaving = setTimeout(() => {
    if (!box.matches(":hover") && document.activeElement !== told) hush();
  }, 300);
}

// One stop of the tabulator in each figure: the given point, or the first that is seen.
function stopAt(figure, point) {
  const seen = [...figure.querySelectorAll(".points:not(.away) circle")];
  for (const each of figure.querySelectorAll("circle[tabindex]")) each.removeAttribute("tabindex");
  (point ?? seen[0])?.setAttribute("tabindex", "0");
}

function neighbour(point, key) {
  const own = [...point.parentNode.children];
  const here = own.indexOf(point);
  const along = { ArrowLeft: here - 1, ArrowRight: here + 1, Home: 0, End: own.length - 1 };
  if (key in along) return own[along[key]];
  const step = { ArrowUp: -1, ArrowDown: 1 }[key];
  const series = [...point.closest("svg").querySelectorAll(".points:not(.away)")];
  const other = step && series[series.indexOf(point.parentNode) + step];
  const away = (each) => Math.abs(each.cx.baseVal.value - point.cx.baseVal.value);
  return other && [...other.children].reduce((a, b) => (away(b) < away(a) ? b : a));
}

for (const point of document.querySelectorAll(".points circle")) {
  const title = point.querySelector("title"); // or the browser would show it as well
  notes.set(point, title.textContent.split("\n"));
  point.setAttribute("aria-label", notes.get(point).join("; "));
  title.remove();
  point.addEventListener("pointerenter", () => tell(point));
  point.addEventListener("pointerleave", leave);
  point.addEventListener("focus", () => tell(point));
  point.addEventListener("blur", leave);
  point.addEventListener("click", () => {
    stopAt(point.closest("svg"), point);
    point.focus({ preventScroll: true });
  });
  point.addEventListener("keydown", (event) => {
    const next = neighbour(point, event.key);
    if (event.key.startsWith("Arrow") || next) event.preventDefault();
    if (!next) return;
    stopAt(point.closest("svg"), next);
    next.focus();
  });
}
for (const svg of document.querySelectorAll(".panels svg")) stopAt(svg);
box.addEventListener("pointerleave", leave);
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape") hush();
});
document.addEventListener("scroll", place, { capture: true, passive: true });
