// The page: which episode is open, beside which other one, at which frame. The address has it all: #episode=…&t=…&compare=….
"use strict";

const KEPT_EPISODES = 16; // so many stay in memory: going back and forth is quick, and a thousand do not pile up
const state = { id: null, other: null };
const loaded = new Map();
const waiting = new Map();
let dataset, list, player, plots = [], open = [], chosenCurves, ranges = [];

// Called by each episode's own script.
function rcsEpisode(data) {
  loaded.set(data.id, data);
  if (loaded.size > KEPT_EPISODES) loaded.delete(loaded.keys().next().value);
}

// Called by dataset.js; null is a page whose writing was interrupted.
function rcsDataset(values) {
  dataset = values;
  const message = document.getElementById("message");
  if (!dataset) { message.textContent = "This page was not completed; write it again."; return; }
  const usual = { instruction: dataset.instruction, seed: null, note: "", why: "", facts: [], flaws: {} };
  dataset.episodes = dataset.episodes.map((episode) => ({ ...usual, ...episode }));
  showFacts(dataset);
  if (!dataset.episodes.length) message.textContent = "No episode is complete yet.";
  chosenCurves = new Set(dataset.curves.flatMap((curve, i) => (curve.shown ? [i] : [])));
  player = new Player(showFrame, (isPlaying) => { document.body.dataset.playing = isPlaying ? "1" : "0"; });
  list = new EpisodeList(dataset, (id) => show({ id }), (other) => show({ other: state.other === other ? null : other }));
  listen();
  window.addEventListener("hashchange", follow);
  follow();
}

// Go where the address says.
function follow() {
  const fields = new URLSearchParams(location.hash.slice(1));
  const known = (id) => (list.known.has(id) ? id : null);
  const id = known(fields.get("episode")) ?? list.shown[0] ?? null;
  show({ id, other: known(fields.get("compare")), frame: Number(fields.get("t")) || 0, isPlayed: fields.has("play") });
}

// The contents that a report, which is one file, has inside instead of beside it.
function inlined(field, value) {
  return [...document.querySelectorAll(`script[data-${field}]`)].find((script) => script.dataset[field] === value)?.textContent;
}

function load(id) {
  if (loaded.has(id)) return Promise.resolve(loaded.get(id));
  const inside = inlined("episode", id);
  if (inside) {
    rcsEpisode(JSON.parse(inside));
    return Promise.resolve(loaded.get(id));
  }
  if (!waiting.has(id)) {
    waiting.set(id, new Promise((resolve, reject) => {
      const script = element("script", { src: `episodes/${encodeURIComponent(id)}.js` });
      script.onload = () => resolve(loaded.get(id));
      script.onerror = () => reject(new Error(`The files of ${id} are missing.`));
      document.head.append(script);
    }).finally(() => { waiting.delete(id); }));
  }
  return waiting.get(id);
}

// Open an episode, or put one beside it; what is not given stays.
async function show({ id = state.id, other = state.other, frame = null, isPlayed = false }) {
  if (other === id) other = null;
  const isSame = id === state.id && other === state.other;
  Object.assign(state, { id, other });
  list.mark(id, other);
  if (isSame && open.length) { if (frame !== null) player.seek(frame); return; }
  const entries = [id, other].filter((one) => one !== null).map((one) => list.known.get(one));
  const message = document.getElementById("message");
  const stage = document.getElementById("stage");
  const hidden = entries.find((entry) => entry.why);
  delete document.body.dataset.episode;
  if (!entries.length || hidden) {
    if (hidden) message.textContent = `Episode ${hidden.id} ${hidden.why}`;
    [message.hidden, stage.hidden] = [false, true];
    open = [];
    player.load([], 1, dataset.fps);
    document.body.dataset.damaged = hidden ? "1" : "0";
    return;
  }
  try {
    const episodes = await Promise.all(entries.map((entry) => load(entry.id)));
    if (state.id !== id || state.other !== other) return; // another one was chosen meanwhile
    open = episodes;
  } catch (error) {
    [message.textContent, message.hidden, stage.hidden] = [error.message, false, true];
    return;
  }
  [message.hidden, stage.hidden] = [true, false];
  const rows = Math.max(...open.map((episode) => episode.rows));
  showHeads(entries);
  player.load(showPictures(entries), rows, dataset.fps);
  showTimeline(rows);
  showChoice();
  showPlots();
  Object.assign(document.body.dataset, { episode: id, compare: other ?? "", rows: String(rows), damaged: "0" });
  player.seek(frame ?? 0);
  if (isPlayed) player.play();
}

function tag(number) {
  return element("span", { className: number ? "tag b" : "tag", textContent: number ? "B" : "A" });
}

function showHeads(entries) {
  document.getElementById("heads").replaceChildren(...entries.map((entry, number) => {
    const facts = [entry.seed !== null && `seed ${entry.seed}`, `${entry.rows} steps, ${seconds(entry.rows, dataset.fps)}`, entry.note];
    const head = element("div", { className: "head" }, ...(entries.length > 1 ? [tag(number)] : []),
      element("b", { textContent: entry.id }), element("span", { className: "badge " + verdict(entry), textContent: told(entry) }),
      ...facts.filter(Boolean).map((fact) => element("span", { className: "fact", textContent: fact })),
      element("span", { textContent: "“" + entry.instruction + "”" }));
    if (number) {
      const close = element("button", { textContent: "Close", title: "Stop comparing (Esc)" });
      close.addEventListener("click", () => show({ other: null }));
      head.append(close);
    }
    if (entries.length === 1 && entry.facts.length) head.append(element("details", {}, element("summary", { textContent: "Outcome" }), table(entry.facts)));
    return head;
  }));
}

// Put up the videos and return them, each with the number of its frames.
function showPictures(entries) {
  const videos = [];
  ranges = [];
  const pictures = document.getElementById("pictures");
  pictures.classList.toggle("two", entries.length > 1);
  pictures.replaceChildren(...entries.map((entry, number) => element("div", { className: "pictures" }, ...dataset.pictures.map((picture, i) => {
    const video = element("video", { muted: true, playsInline: true, preload: "auto", disablePictureInPicture: true });
    const range = element("span");
    const limits = open[number].limits[i];
    if (limits) ranges.push((frame) => { range.textContent = scale(limits[Math.min(frame, limits.length - 1)], picture.unit); });
    const figure = element("figure", {}, video, element("figcaption", {}, ...(entries.length > 1 ? [tag(number)] : []), picture.label, range));
    figure.dataset.aspect = picture.aspect;
    video.dataset.picture = picture.label;
    video.addEventListener("error", () => {
      if (video.getAttribute("src")) video.replaceWith(element("p", { className: "wrong", textContent: "This browser cannot play the clip. Write the page again with --codec vp9." }));
    });
    video.addEventListener("click", () => player.toggle());
    video.src = inlined("clip", `${i} ${entry.id}`) ?? `clips/${encodeURIComponent(entry.id)}/${picture.file}`;
    videos.push({ video, rows: entry.rows });
    return figure;
  }))));
  arrange();
  return videos;
}

// Make the pictures of an episode as large as the width and a share of the window's height permit.
function arrange() {
  const gap = 10;
  for (const box of document.querySelectorAll(".pictures")) {
    const figures = [...box.children];
    box.style.width = "auto";
    const aspects = figures.map((figure) => Number(figure.dataset.aspect));
    const most = window.innerHeight * (open.length > 1 && window.innerWidth < 1000 ? 0.36 : 0.58);
    let [height, width] = [0, 0];
    for (let n = figures.length; n > 0; n--) {
      const lines = Math.ceil(figures.length / n);
      const widest = Math.max(...Array.from({ length: lines }, (_, i) => aspects.slice(i * n, (i + 1) * n).reduce((a, b) => a + b)));
      const fits = Math.min((box.clientWidth - gap * (n - 1) - 1) / widest, (most - gap * (lines - 1)) / lines);
      if (fits > 1.1 * height) [height, width] = [fits, widest * fits + gap * (n - 1) + 1]; // one line, unless more are clearly larger
    }
    box.style.width = `${width}px`;
    figures.forEach((figure, i) => { Object.assign(figure.style, { height: `${height}px`, width: `${height * aspects[i]}px` }); });
  }
}

function showTimeline(rows) {
  const lanes = [{ name: "", marks: [], isMain: true }];
  open.forEach((episode, number) => {
    const places = [...new Set(episode.marks.map((mark) => mark.at))];
    const prefix = open.length > 1 ? (number ? "B " : "A ") : "";
    for (const place of places) lanes.push({ name: prefix + place, marks: episode.marks.filter((mark) => mark.at === place) });
  });
  document.getElementById("lanes").replaceChildren(...lanes.map((lane) => {
    const canvas = element("canvas");
    lane.draw = () => drawLane(canvas, lane.marks, rows);
    return element("div", { className: lane.isMain ? "lane main" : "lane" }, element("span", { textContent: lane.name, title: lane.name }), canvas);
  }));
  document.getElementById("timeline").classList.toggle("named", lanes.length > 1);
  showTimeline.redraw = () => { for (const lane of lanes) lane.draw(); };
  showTimeline.redraw();
  const counts = {};
  for (const episode of open) for (const [flaw, count] of Object.entries(episode.flaws)) counts[flaw] = (counts[flaw] || 0) + count;
  const words = Object.entries(counts).map(([flaw, count]) => element("span", {}, Object.assign(element("i"), { style: `background: var(--${flaw})` }), `${FLAW_WORDS[flaw]} ${count}`));
  document.getElementById("flaws").replaceChildren(...(words.length ? words : ["no flaw in this recording"]));
}

function showChoice() {
  document.getElementById("choice").replaceChildren(...dataset.curves.map((curve, i) => {
    const button = element("button", { textContent: curve.label });
    button.setAttribute("aria-pressed", String(chosenCurves.has(i)));
    button.addEventListener("click", () => {
      if (!chosenCurves.delete(i)) chosenCurves.add(i);
      button.setAttribute("aria-pressed", String(chosenCurves.has(i)));
      showPlots();
    });
    return button;
  }));
}

function showPlots() {
  plots = dataset.curves.flatMap((curve, i) => (chosenCurves.has(i) ? [new Plot(curve, i, (frame) => player.seek(frame))] : []));
  document.getElementById("plots").replaceChildren(...plots.map((plot) => plot.figure));
  redraw();
}

function redraw() {
  if (!open.length) return;
  arrange();
  for (const plot of plots) plot.draw(open, player.rows, dataset.fps);
  showTimeline.redraw();
  showFrame(player.frame);
}

// Everything that follows the time.
function showFrame(frame) {
  if (!open.length) return;
  for (const plot of plots) plot.at(frame);
  for (const tell of ranges) tell(frame);
  const share = frame / Math.max(1, player.rows - 1);
  const timeline = document.getElementById("timeline");
  const left = parseFloat(getComputedStyle(timeline).paddingLeft);
  timeline.querySelector(".past").style.left = `${left}px`;
  timeline.querySelector(".past").style.width = `calc(${share} * (100% - ${left}px))`;
  timeline.querySelector(".cursor").style.left = `calc(${left}px + ${share} * (100% - ${left}px))`;
  timeline.setAttribute("aria-valuemax", String(player.rows - 1));
  timeline.setAttribute("aria-valuenow", String(frame));
  document.getElementById("clock").textContent = `step ${frame} of ${player.rows - 1} \u00b7 ${(frame / dataset.fps).toFixed(2)} s`;
  document.body.dataset.frame = String(frame);
  if (!player.isPlaying) remember();
}

// Keep the address up to date, so that what is seen can be passed on; not with every frame of a drag.
function remember() {
  clearTimeout(remember.timer);
  remember.timer = setTimeout(() => {
    const fields = new URLSearchParams({ episode: state.id, t: player.frame, ...(state.other !== null && { compare: state.other }) });
    history.replaceState(null, "", "#" + fields);
  }, 150);
}

function listen() {
  const on = (id, event, action) => document.getElementById(id).addEventListener(event, action);
  on("play", "click", () => player.toggle());
  const step = (by) => { player.pause(); player.seek(player.frame + by); };
  on("back", "click", () => step(-1));
  on("forward", "click", () => step(1));
  on("speed", "change", (event) => player.setSpeed(Number(event.target.value)));
  const timeline = document.getElementById("timeline");
  const at = (event) => {
    const box = document.getElementById("lanes").getBoundingClientRect();
    player.seek(((event.clientX - box.left) / box.width) * (player.rows - 1));
  };
  timeline.addEventListener("pointerdown", (event) => { timeline.setPointerCapture(event.pointerId); at(event); });
  timeline.addEventListener("pointermove", (event) => { if (event.buttons & 1) at(event); });
  const keys = {
    j: () => show({ id: list.next(state.id, 1) }),
    k: () => show({ id: list.next(state.id, -1) }),
    c: () => show({ other: state.other === null ? list.next(state.id, 1) : null }),
    Escape: () => show({ other: null }),
    " ": () => player.toggle(),
    ArrowLeft: (event) => step(event.shiftKey ? -10 : -1),
    ArrowRight: (event) => step(event.shiftKey ? 10 : 1),
    Home: () => step(-player.rows),
    End: () => step(player.rows),
    "/": () => document.getElementById("search").focus(),
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.target.matches("input, select")) {
      if (event.key === "Escape") event.target.blur();
      return;
    }
    if (!keys[event.key] || !open.length && !"jk/".includes(event.key)) return;
    event.preventDefault();
    keys[event.key](event);
  });
  let resized;
  window.addEventListener("resize", () => { cancelAnimationFrame(resized); resized = requestAnimationFrame(redraw); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
}
