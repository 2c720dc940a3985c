// All folds at once, and the fold around what a link leads to.
const everything = document.getElementById("open-all");
if (everything) {
  everything.hidden = false;
  let open = false;
  everything.addEventListener("click", () => {
    open = !open;
    for (const fold of document.querySelectorAll("details")) fold.open = open;
    everything.textContent = open ? "Close everything" : "Open everything";
  });
}

function unfold() {
  const target = document.getElementById(window.location.hash.slice(1));
  let closed = false;
  for (let fold = target?.closest("details"); fold; fold = fold.parentElement.closest("details")) {
    closed ||= !fold.open;
    fold.open = true;
  }
  if (closed) target.scrollIntoView();
}
unfold();
window.addEventListener("hashchange", unfold);
document.addEventListener("click", (event) => {
  const link = event.target.closest?.('a[href^="#"]');
  if (link && link.hash === window.location.hash) unfold(); // no change, no event
});
