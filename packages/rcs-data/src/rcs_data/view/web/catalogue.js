// The facts of the dataset, and the list of its episodes with filters.
"use strict";

const FLAW_WORDS = {
  repeated: "repeated frames", stale: "stale frames", missing: "missing frames", dropped: "dropped frames",
  gap: "gaps", jitter: "jitter", backwards: "time runs backwards",
};

function verdict(episode) {
  if (episode.damaged) return "damaged";
  return episode.success === null ? "unknown" : episode.success ? "success" : "failure";
}

// The same in words.
function told(episode) {
  return verdict(episode).replace("unknown", "not judged");
}

function table(rows) {
  const cells = (row) => [element("th", { textContent: row[0] }), element("td", { textContent: row[1] })];
  return element("table", {}, ...rows.map((row) => element("tr", {}, ...cells(row))));
}

function seconds(rows, fps) {
  const time = Math.max(0, rows - 1) / fps;
  return time < 60 ? time.toFixed(1) + " s" : `${Math.floor(time / 60)} min ${Math.floor(time % 60)} s`;
}

function showFacts(dataset) {
  const { counts } = dataset;
  document.title = dataset.name;
  document.getElementById("name").textContent = dataset.name;
  document.getElementById("instruction").textContent = dataset.instruction;
  const robot = Object.fromEntries(dataset.setup);
  const percent = (rate) => (100 * rate).toFixed(1);
  const rate = counts.judged ? percent(counts.successes / counts.judged) + " %" : "–";
  const range = counts.judged ? ` (95 %: ${percent(counts.low)}–${percent(counts.high)} %)` : "";
  const facts = [
    [[robot.task, robot.robot].filter(Boolean).join(", ") || "–", "setup"],
    [dataset.episodes.length, dataset.episodes.length === 1 ? "episode" : "episodes"],
    [rate, `success, ${counts.successes} of ${counts.judged}${range}`],
    [counts.rows.toLocaleString("en").replaceAll(",", "\u202f"), `steps at ${dataset.fps} Hz`],
    [(counts.rows / dataset.fps / 60).toFixed(1) + " min", "in all"],
  ];
  document.getElementById("counts").replaceChildren(...facts.map(([value, name]) =>
    element("div", {}, element("dt", { textContent: name }), element("dd", { textContent: value }))));
  const about = document.getElementById("about");
  const column = (name, ...content) => element("div", {}, element("h2", { textContent: name }), ...content);
  const whole = element("details", {}, element("summary", { textContent: "All of the setup" }), element("pre", { textContent: dataset.wholeSetup }));
  const note = element("p", { className: "dim", textContent: `Page of ${dataset.made}. It is complete in itself and loads nothing from elsewhere.` });
  const speed = dataset.isFasterThanLife ? [element("p", { className: "dim", textContent: "Simulated without waiting for the clock: periods are computing times, and are not checked." })] : [];
  const features = element("details", {}, element("summary", { textContent: dataset.features.length + " features" }), table(dataset.features));
  const failures = dataset.failures.length ? table(dataset.failures) : element("p", { className: "dim", textContent: "No episode failed." });
  about.append(element("div", { className: "tables" }, column("Failures by class", failures), column("Recording", table(dataset.recording), ...speed), column("Setup", table(dataset.setup), whole, features)), note);
  const button = document.getElementById("about-button");
  button.addEventListener("click", () => {
    about.hidden = !about.hidden;
    button.setAttribute("aria-expanded", String(!about.hidden));
    window.dispatchEvent(new Event("resize"));
  });
}

const BLOCK = 100; // so many episodes become elements together, when they come near to where the list is looked at

class EpisodeList {
  // `choose` takes an id, `compare` takes the id to compare with.
  constructor(dataset, choose, compare) {
    Object.assign(this, { dataset, choose, compare, marked: [null, null], shown: [], places: new Map() });
    this.list = document.getElementById("list");
    this.filter = { text: "", verdict: "all", flaw: "any", order: "id" };
    this.known = new Map(dataset.episodes.map((episode) => [episode.id, episode]));
    const look = ({ target, isIntersecting }) => (isIntersecting ? this.fill(target) : this.empty(target));
    this.eye = new IntersectionObserver((seen) => seen.forEach(look), { root: this.list, rootMargin: "2000px" });
    const named = dataset.flaws.filter((flaw) => dataset.episodes.some((episode) => episode.flaws[flaw]));
    const options = [["any", "Any quality"], ["none", "Without flaws"], ["some", "With flaws"], ...named.map((flaw) => [flaw, "With " + FLAW_WORDS[flaw]])];
    document.getElementById("flaw").append(...options.map(([value, textContent]) => element("option", { value, textContent })));
    const listen = (id, event, field) => document.getElementById(id).addEventListener(event, (e) => this.set({ [field]: e.target.value }));
    listen("search", "input", "text");
    listen("flaw", "change", "flaw");
    listen("order", "change", "order");
    this.buttons = [...document.querySelectorAll("[data-verdict]")];
    for (const button of this.buttons) button.addEventListener("click", () => this.set({ verdict: button.dataset.verdict }));
    this.episodes = dataset.episodes.map((episode) => ({
      ...episode,
      verdict: verdict(episode),
      total: Object.values(episode.flaws).reduce((sum, count) => sum + count, 0),
      text: [episode.id, episode.instruction, episode.note, episode.seed].join(" ").toLowerCase(),
    }));
    this.set({});
  }

  item(episode) {
    const { dataset, choose, compare } = this;
    const flaws = element("span", { className: "flawmarks", title: Object.entries(episode.flaws).map(([flaw, count]) => `${FLAW_WORDS[flaw]}: ${count}`).join("\n") });
    for (const flaw of Object.keys(episode.flaws)) flaws.append(Object.assign(element("i"), { style: `background: var(--${flaw})` }));
    const button = element("button", { textContent: "⇄", title: "Compare with this one" });
    button.addEventListener("click", (event) => { event.stopPropagation(); compare(episode.id); });
    const item = element("li", {},
      element("span", { className: "dot " + verdict(episode), title: told(episode) }),
      element("span", { className: "id", textContent: episode.id, title: episode.id }),
      element("span", { className: "length" }, flaws, episode.damaged ? "damaged" : seconds(episode.rows, dataset.fps)),
      button);
    const note = episode.note || (episode.instruction !== dataset.instruction && episode.instruction) || "";
    if (note) item.append(element("span", { className: "note", textContent: note }));
    item.addEventListener("click", () => choose(episode.id));
    item.dataset.id = episode.id;
    return this.dress(item);
  }

  fill(block) {
    if (block.childElementCount) return;
    block.append(...block.ids.map((id) => this.item(this.known.get(id))));
    block.style.height = "auto";
  }

  empty(block) {
    if (!block.childElementCount || !block.isConnected) return;
    block.style.height = `${block.offsetHeight}px`;
    block.replaceChildren();
  }

  dress(item) {
    item.toggleAttribute("aria-current", item.dataset.id === this.marked[0]);
    item.classList.toggle("other", item.dataset.id === this.marked[1]);
    return item;
  }

  // Change the filters and show what fits.
  set(changes) {
    Object.assign(this.filter, changes);
    const { text, order } = this.filter;
    const words = text.toLowerCase().split(/\s+/).filter(Boolean);
    const flawed = { any: () => true, none: (e) => !e.total && !e.damaged, some: (e) => e.total > 0 || e.damaged };
    const fits = flawed[this.filter.flaw] || ((e) => e.flaws[this.filter.flaw] > 0);
    const isWanted = (e) => this.filter.verdict === "all" || e.verdict === this.filter.verdict || (this.filter.verdict === "unknown" && e.damaged);
    const orders = { longest: (a, b) => b.rows - a.rows, shortest: (a, b) => a.rows - b.rows, flaws: (a, b) => b.total - a.total };
    const shown = this.episodes.filter((e) => isWanted(e) && fits(e) && words.every((word) => e.text.includes(word)));
    if (orders[order]) shown.sort(orders[order]);
    this.shown = shown.map((episode) => episode.id);
    this.places = new Map(this.shown.map((id, place) => [id, place]));
    this.eye.disconnect();
    this.list.replaceChildren(...Array.from({ length: Math.ceil(shown.length / BLOCK) }, (_, i) => {
      const block = element("ol", { ids: this.shown.slice(i * BLOCK, (i + 1) * BLOCK) });
      block.style.height = `${33 * block.ids.length}px`;
      this.eye.observe(block);
      return block;
    }));
    if (this.list.firstChild) this.fill(this.list.firstChild);
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(button.dataset.verdict === this.filter.verdict));
    const wins = shown.filter((e) => e.success === true).length;
    const judged = shown.filter((e) => e.success !== null).length;
    document.getElementById("shown").textContent = `${shown.length} of ${this.episodes.length} shown` + (judged ? `, ${wins} of ${judged} succeeded` : "");
    document.body.dataset.shown = String(shown.length);
  }

  // Mark which episodes are open.
  mark(id, other) {
    this.marked = [id, other];
    const block = Math.floor(this.places.get(id) / BLOCK);
    for (const near of [block - 1, block, block + 1]) if (this.list.children[near]) this.fill(this.list.children[near]);
    for (const item of this.list.querySelectorAll("li")) this.dress(item);
    this.list.querySelector("li[aria-current]")?.scrollIntoView({ block: "nearest" });
  }

  // Return the id that is `by` places further in the list as it is shown.
  next(id, by) {
    const place = this.places.get(id) ?? -1;
    return this.shown[place < 0 ? 0 : Math.max(0, Math.min(this.shown.length - 1, place + by))];
  }
}
