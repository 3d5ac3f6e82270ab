"use strict";
const all = [...document.querySelectorAll("li")], by = (id) => document.getElementById(id);
function filter() {
  const words = by("words").value.toLowerCase().split(/\s+/), state = by("state").value;
  const least = +by("least").value || 0;
  let n = 0;
  for (const item of all) {
    const { words: said, state: its, peak } = item.dataset;
    const fits = (!state || its === state) && (!least || +peak >= least);
    item.hidden = !(fits && words.every((word) => said.includes(word)));
    n += !item.hidden;
  }
  by("count").textContent = `${n} of ${all.length}`;
}
function sort() {
  const key = by("order").value, list = document.querySelector("ol");
  const order = { plan: (a, b) => a.dataset.index - b.dataset.index, force: (a, b) => b.dataset.peak - a.dataset.peak };
  list.append(...[...all].sort(order[key]));
}
for (const id of ["words", "state", "least"]) by(id).oninput = filter;
by("order").oninput = sort;
document.querySelector("ol").onclick = (event) => {
  if (event.target.tagName !== "A") return;
  for (const item of all) item.classList.toggle("on", item.contains(event.target));
};
filter();
document.querySelector("li a")?.click();
