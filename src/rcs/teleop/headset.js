// The page in a headset: sends both controllers with every picture that the headset shows, and shows cameras.
"use strict";

const element = (name) => document.getElementById(name);
const KEPT_BACK = 4096; // bytes that wait to be sent; beyond this, the network is too slow and frames are left out
const PANEL = { distance: 1.2, width: 0.6, gap: 0.03, drop: 0.15 }; // where cameras are shown [m]

let socket = null, isAccepted = false, number = 0, roundTrip = 0;
const sent = new Map(); // time of each frame whose echo has not come, by number
const pictures = new Map(); // canvas and, in a session, texture of each camera
let states = {}, session = null, gl = null, panels = null;

function say(text, isBad = false) {
  element("state").textContent = text;
  element("state").className = isBad ? "bad" : "";
}

// --- Connection ---

function connect(code) {
  if (socket) socket.close();
  const own = socket = new WebSocket(`wss://${location.host}/stream`);
  socket.binaryType = "arraybuffer";
  say("Connecting …");
  own.onopen = () => own.send(code);
  own.onmessage = (event) => typeof event.data === "string" ? hear(JSON.parse(event.data), code) : draw(event.data);
  own.onclose = () => {
    if (own !== socket) return;
    if (isAccepted) say("The connection is lost; connecting again …", true);
    isAccepted = false;
    element("ar").disabled = element("vr").disabled = true;
    if (localStorage.getItem("code") === code) setTimeout(() => own === socket && connect(code), 1000);
  };
}

async function hear(message, code) {
  if (message.refused) {
    if (message.is_wrong_code) localStorage.removeItem("code");
    element("login").hidden = false;
    say(message.refused, true);
  } else if (message.accepted) {
    localStorage.setItem("code", code);
    element("login").hidden = true;
    isAccepted = true;
    number = roundTrip = 0;
    sent.clear();
    say("Connected.");
    if (!navigator.xr) return say("This browser knows no headset.", true);
    element("ar").disabled = !await navigator.xr.isSessionSupported("immersive-ar");
    element("vr").disabled = !await navigator.xr.isSessionSupported("immersive-vr");
  } else if ("echo" in message) {
    const way = performance.now() - sent.get(message.echo);
    for (const old of sent.keys()) if (old <= message.echo) sent.delete(old);
    if (way > 0) roundTrip = roundTrip ? Math.min(roundTrip * 1.0005, way) : way;
  } else if (message.states) {
    for (const [hand, state] of Object.entries(message.states))
      if (states[hand] !== state) pulse(hand, state === "engaged" ? 0.6 : 0.3);
    states = message.states;
    say(Object.entries(states).map(([hand, state]) => `${hand}: ${state}`).join(", ") +
      (roundTrip ? ` · ${roundTrip.toFixed(0)} ms there and back` : ""));
  }
}

function pulse(hand, strength) {
  for (const source of session ? session.inputSources : [])
    if (source.handedness === hand) source.gamepad?.hapticActuators?.[0]?.pulse?.(strength, 40);
}

// --- Controllers ---

function handOf(source, frame, space) {
  const found = source.gripSpace && frame.getPose(source.gripSpace, space);
  const { position: p, orientation: q } = found ? found.transform : {};
  const isSeen = found && !found.emulatedPosition && session.visibilityState === "visible";
  let buttons = 0;
  source.gamepad.buttons.forEach((button, at) => { if (button.pressed && at < 16) buttons |= 1 << at; });
  return {
    pose: isSeen ? [p.x, p.y, p.z, q.x, q.y, q.z, q.w] : null,
    trigger: Math.min(Math.max(source.gamepad.buttons[0]?.value ?? 0, 0), 1),
    buttons,
    stick: Math.min(Math.max(source.gamepad.axes[3] ?? 0, -1), 1),
  };
}

function tell(frame, space) {
  if (!isAccepted || socket.readyState !== WebSocket.OPEN || socket.bufferedAmount > KEPT_BACK) return;
  const hands = {};
  for (const source of session.inputSources)
    if (source.gamepad && source.handedness !== "none") hands[source.handedness] = handOf(source, frame, space);
  const time = performance.now();
  sent.set(number, time);
  socket.send(JSON.stringify({ number: number++, time, round_trip: roundTrip, hands }));
}

// --- Session ---

async function begin(mode) {
  session = await navigator.xr.requestSession(mode, { requiredFeatures: ["local-floor"] });
  const canvas = document.createElement("canvas");
  gl = canvas.getContext("webgl2", { xrCompatible: true, alpha: true });
  session.updateRenderState({ baseLayer: new XRWebGLLayer(session, gl) });
  const space = await session.requestReferenceSpace("local-floor");
  panels = makePanels();
  session.onend = () => {
    session = gl = panels = null;
    for (const picture of pictures.values()) picture.texture = null;
  };
  const step = (_, frame) => {
    if (!session) return;
    session.requestAnimationFrame(step);
    tell(frame, space);
    show(frame, space);
  };
  session.requestAnimationFrame(step);
}

// --- Cameras ---

async function draw(data) {
  const size = new Uint8Array(data)[0];
  const name = new TextDecoder().decode(data.slice(1, 1 + size));
  const image = await createImageBitmap(new Blob([data.slice(1 + size)], { type: "image/jpeg" }));
  let picture = pictures.get(name);
  if (!picture) {
    picture = { canvas: document.createElement("canvas"), texture: null, isNew: true };
    picture.canvas.title = name;
    element("pictures").append(picture.canvas);
    pictures.set(name, picture);
  }
  picture.canvas.width = image.width;
  picture.canvas.height = image.height;
  picture.canvas.getContext("2d").drawImage(image, 0, 0);
  picture.isNew = true;
}

function makePanels() {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, `#version 300 es
      uniform mat4 projection, toEye, toSpace; uniform vec2 size; uniform vec2 middle; out vec2 at;
      void main() {
        at = vec2(gl_VertexID & 1, gl_VertexID >> 1);
        gl_Position = projection * toEye * toSpace * vec4(middle + (at - 0.5) * size, 0, 1);
      }`],
    [gl.FRAGMENT_SHADER, `#version 300 es
      precision mediump float; uniform sampler2D picture; in vec2 at; out vec4 colour;
      void main() { colour = vec4(texture(picture, vec2(at.x, 1.0 - at.y)).rgb, 1); }`],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  const uniform = (name) => gl.getUniformLocation(program, name);
  return { program, place: null, projection: uniform("projection"), toEye: uniform("toEye"),
    toSpace: uniform("toSpace"), size: uniform("size"), middle: uniform("middle") };
}

// The panels stand in front of where the person looks first, upright.
function placeOf(view) {
  const m = view.transform.matrix, length = Math.hypot(m[8], m[10]) || 1;
  const [x, z] = [m[8] / length, m[10] / length];
  return new Float32Array([z, 0, -x, 0, 0, 1, 0, 0, x, 0, z, 0,
    m[12] - PANEL.distance * x, m[13] - PANEL.drop, m[14] - PANEL.distance * z, 1]);
}

function upload(picture) {
  if (!picture.texture) {
    picture.texture = gl.createTexture();
    picture.isNew = true;
  }
  gl.bindTexture(gl.TEXTURE_2D, picture.texture);
  if (!picture.isNew) return;
  picture.isNew = false;
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, picture.canvas);
  for (const [name, value] of [["MIN_FILTER", "LINEAR"], ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]])
    gl.texParameteri(gl.TEXTURE_2D, gl[`TEXTURE_${name}`], gl[value]);
}

function show(frame, space) {
  const layer = session.renderState.baseLayer;
  gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
  gl.clearColor(0, 0, 0, 0);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  const seen = frame.getViewerPose(space);
  if (!seen || pictures.size === 0) return;
  panels.place ??= placeOf(seen.views[0]);
  gl.useProgram(panels.program);
  gl.uniformMatrix4fv(panels.toSpace, false, panels.place);
  for (const view of seen.views) {
    const { x, y, width, height } = layer.getViewport(view);
    gl.viewport(x, y, width, height);
    gl.uniformMatrix4fv(panels.projection, false, view.projectionMatrix);
    gl.uniformMatrix4fv(panels.toEye, false, view.transform.inverse.matrix);
    let at = -0.5 * (pictures.size - 1) * (PANEL.width + PANEL.gap);
    for (const picture of pictures.values()) {
      upload(picture);
      gl.uniform2f(panels.size, PANEL.width, PANEL.width * picture.canvas.height / picture.canvas.width);
      gl.uniform2f(panels.middle, at, 0);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
      at += PANEL.width + PANEL.gap;
    }
  }
}

element("login").onsubmit = (event) => {
  event.preventDefault();
  connect(element("code").value.trim().toLowerCase());
};
for (const mode of ["ar", "vr"])
  element(mode).onclick = () => begin(`immersive-${mode}`).catch((error) => say(`${error.message}`, true));

const known = location.hash.slice(1) || localStorage.getItem("code");
if (known) connect(known);
else say("Type the code that the program shows.");
