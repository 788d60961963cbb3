// The messages of a page to the program; page_link.py runs it in every page, and puts WORDS in.
"use strict";

const { token, codes, beat } = WORDS;
window.rcsLink?.close();
const link = window.rcsLink = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/link?${token}`);
const held = new Set();
const ending = new AbortController();
let isLeading = false; // whether keys lead a robot
let clock = null;

function say() {
  if (link.readyState === WebSocket.OPEN && link.bufferedAmount < 4096)
    link.send(JSON.stringify({ time: performance.now(), is_seen: document.visibilityState === "visible", keys: [...held] }));
}

function letGo() {
  held.clear();
  say();
}

const isTyping = (target) => target.isContentEditable || target.matches?.("textarea, input:not([type=checkbox]):not([type=range])");

function onKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey) return letGo(); // the system may keep releases to itself
  const isDown = event.type === "keydown", name = codes[event.code];
  if (!isLeading || !name || (isDown && isTyping(event.target))) return;
  event.preventDefault(); // neither the view nor a button that has the focus is meant
  event.stopImmediatePropagation();
  if (event.repeat || held.has(name) === isDown) return; // one that was let go of has to be pressed anew
  isDown ? held.add(name) : held.delete(name);
  say();
}

for (const kind of ["keydown", "keyup"]) window.addEventListener(kind, onKey, { capture: true, signal: ending.signal });
for (const kind of ["blur", "pagehide"]) window.addEventListener(kind, letGo, { signal: ending.signal });
document.addEventListener("visibilitychange", letGo, { signal: ending.signal });
link.onmessage = (event) => {
  isLeading = JSON.parse(event.data).leads;
  if (isLeading) document.activeElement?.blur();
  letGo();
};
link.onopen = () => { clock = setInterval(say, beat); say(); };
link.onclose = () => { clearInterval(clock); ending.abort(); };
