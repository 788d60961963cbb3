// Tells the figures of the moment under the pointer, in every chart at once.
"use strict";

const charts = [...document.querySelectorAll("figure.plot")].map((figure) => ({
  figure,
  svg: figure.querySelector("svg"),
  here: figure.querySelector(".here"),
  readout: figure.querySelector(".readout"),
  about: JSON.parse(figure.dataset.about),
}));

function nearest(values, wanted) {
  let best = 0;
  values.forEach((value, i) => { if (Math.abs(value - wanted) < Math.abs(values[best] - wanted)) best = i; });
  return best;
}

function show(steps) {
  for (const { here, readout, about } of charts) {
    const told = about.series.map(({ name, x, told }) => {
      const i = nearest(x, steps);
      return { at: x[i], text: (about.series.length > 1 ? name + " " : "") + told[i] };
    });
    const place = about.left + (told[0].at / about.most) * about.width;
    here.setAttribute("x1", place);
    here.setAttribute("x2", place);
    here.removeAttribute("hidden");
    readout.textContent = `step ${told[0].at.toLocaleString("en")}: ` + told.map(({ text }) => text).join(", ");
  }
}

for (const { svg, about } of charts) {
  svg.addEventListener("pointermove", (event) => {
    const box = svg.getBoundingClientRect();
    const x = ((event.clientX - box.left) / box.width) * about.size;
    show(Math.max(0, Math.min(1, (x - about.left) / about.width)) * about.most);
  });
}
