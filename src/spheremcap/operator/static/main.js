/** The page: what is open, what is asked, what a person does about it. */

import { CHAIR_COLOURS, Chair } from "./chair.js";
import { get, post, send } from "./http.js";
import { Pictures } from "./pictures.js";
import { TimeLine } from "./timeline.js";
import { View } from "./view.js";

/** @param {string} id @returns {any} */
const $ = (id) => document.getElementById(id);
const COLOURS = ["#3fd0ff", "#ffd23f", "#ff7ad9", "#8dff6b", "#ff9b4a", "#c3acff"];
const NONE = 0, ESTIMATED = 3, LOST = 4; // status codes
const BLOCK = 400; // frames whose states are fetched at once
const BLOCKS_KEPT = 20;

const S = {
  /** @type {any} */ session: null,
  /** @type {any[]} */ answers: [],
  /** @type {any[]} */ requests: [],
  /** @type {Record<string, [number, number][]>} */ lanes: {},
  /** @type {Map<number, any>} */ blocks: new Map(),
  lanesRevision: -2, answersRevision: -1,
  frame: -1, marker: "", request: -1,
  /** @type {Map<string, any>} */ drafts: new Map(), // circles that are not saved, by marker and frame
  /** @type {number | null} */ hiddenFrom: null,
  /** @type {any} */ trial: null,
  /** @type {any} */ snap: null,
  /** @type {any} */ job: null,
  /** @type {any[]} */ proposed: [], // neither kept nor thrown away yet
  unwritten: 0, shown: -1, asked: 0, seenByLanes: -1,
};

// --- saying things ---

/** @param {string} text */
function message(text) { $("message-text").textContent = text; $("message").hidden = !text; }
$("message-close").onclick = () => message("");

/** @param {"saving" | "done" | "failed"} how @param {string} text */
function saved(how, text) { $("saved").className = how; $("saved").textContent = text; }

/** Do something that may be refused, and say it where it is. @template T @param {() => Promise<T>} act @returns {Promise<T | null>} */
async function attempt(act) {
  try {
    const done = await act();
    message("");
    return done;
  } catch (error) {
    message(/** @type {Error} */ (error).message);
    return null;
  }
}

// --- the picture ---

const pictures = new Pictures((picture, wanted) => {
  if (wanted !== S.frame) return;
  const exact = picture.frame === wanted;
  view.show(picture.image, picture.frame, exact);
  S.shown = picture.frame;
  $("busy").hidden = true;
  caption(picture.frame, picture.seconds);
  overlays();
}, (error) => message(error.message));
setInterval(() => { $("busy").hidden = !pictures.waiting; }, 150);

const view = new View($("picture"), {
  moved: (circle, done) => { draft(circle); if (done && $("auto-snap").checked) snap(); },
  pointed: (k, at, done) => chair.hold(k, S.frame, at, done),
  zoomed: (scale) => { $("zoom").textContent = `${Math.round(scale * 100)} %`; },
});
const line = new TimeLine($("lanes"), (frame, done) => go(frame, !done));

/** @param {number} shown @param {number} seconds */
function caption(shown, seconds) {
  const s = S.session;
  $("caption").textContent = `Frame ${shown} of ${s.first}–${s.last} · ${clock(seconds)}${shown === S.frame ? "" : ` (nearest key frame to ${S.frame})`}`;
  if (document.activeElement !== $("time") && shown === S.frame) $("time").value = clock(seconds);
}

/** @param {number} seconds */
function clock(seconds) {
  const minutes = Math.floor(seconds / 60);
  return `${minutes}:${(seconds - 60 * minutes).toFixed(3).padStart(6, "0")}`;
}

/** @param {number} frame @param {boolean} [scrubbing] */
function go(frame, scrubbing = false) {
  const { first, last } = S.session;
  frame = Math.min(last, Math.max(first, Math.round(frame)));
  if (Number.isNaN(frame)) return;
  const moved = frame !== S.frame;
  S.frame = frame;
  if (moved) { S.snap = null; view.mask = null; }
  pictures.look(frame, { scrubbing, first, last });
  line.at(frame);
  if (document.activeElement !== $("frame")) $("frame").value = frame;
  $("lanes").setAttribute("aria-valuenow", frame);
  $("lanes").setAttribute("aria-valuetext", `frame ${frame}`);
  overlays();
  remember();
}

// --- states ---

/** What stands of a marker on a frame: [code, [x, y, r] | null, metres, votes, reasons] or null; undefined while it is fetched.
 * @param {string} marker @param {number} frame @returns {any} */
function state(marker, frame) {
  if (S.session.kind !== "recording") return null;
  const start = Math.floor(frame / BLOCK) * BLOCK;
  const block = S.blocks.get(start);
  if (!block || block.revision !== S.lanesRevision) fetchStates(start);
  return block?.states ? block.states[marker]?.[frame - block.first] : undefined;
}

/** What the trial would put on a frame of its marker. @param {number} frame @returns {any} */
function trialState(frame) {
  const block = S.blocks.get(Math.floor(frame / BLOCK) * BLOCK);
  return block?.trial?.[frame - block.first];
}

/** @param {number} start */
async function fetchStates(start) {
  const block = S.blocks.get(start), revision = S.lanesRevision, trial = S.trial;
  if (block?.fetching) return;
  S.blocks.set(start, { ...block, fetching: true });
  try {
    const said = await get(`/states?first=${Math.max(0, start)}&last=${start + BLOCK - 1}`);
    S.blocks.delete(start);
    if (trial !== S.trial) return; // of a moment before
    S.blocks.set(start, { first: said.first, states: said.states, trial: said.trial, revision, fetching: false });
    for (const old of S.blocks.keys()) { if (S.blocks.size <= BLOCKS_KEPT) break; S.blocks.delete(old); }
    overlays();
  } catch { S.blocks.set(start, { ...block, fetching: false }); }
}

/** @param {number} first @param {number} last */
async function statesOf(first, last) {
  return get(`/states?first=${first}&last=${last}`);
}

function colourOf(marker) {
  const index = S.session.markers.findIndex((/** @type {any} */ m) => m.name === marker);
  return COLOURS[Math.max(0, index) % COLOURS.length];
}

/** @param {string} marker @param {number} frame */
function givenCircle(marker, frame) {
  const a = S.answers.find((one) => one.kind === "circle" && one.marker === marker && one.frame === frame);
  return a ? { x: a.x_px, y: a.y_px, r: a.r_px } : null;
}

const key = () => `${S.marker}@${S.frame}`;

/** What is drawn over the picture, and what is said of this frame. */
function overlays() {
  if (!S.session || S.frame < 0) return;
  const exact = S.shown === S.frame;
  /** @type {import("./view.js").Drawn[]} */ const drawn = [];
  const given = S.drafts.get(key()) ?? givenCircle(S.marker, S.frame);
  view.circle = exact ? given : null;
  view.colour = S.marker ? colourOf(S.marker) : COLOURS[0];
  for (const { name } of exact ? S.session.markers : []) {
    const here = state(name, S.frame);
    if (S.trial?.answer.marker === name && S.frame >= S.trial.first && S.frame <= S.trial.last) {
      const now = trialState(S.frame);
      if (here?.[1]) drawn.push({ circle: circleOf(here[1]), colour: "#ff6a4d", dash: [6, 5] });
      if (now?.[1]) drawn.push({ circle: circleOf(now[1]), colour: "#3ddc9e", width: 3, label: name });
      continue;
    }
    if (here?.[1] && !(name === S.marker && given)) {
      drawn.push({ circle: circleOf(here[1]), colour: colourOf(name), dash: here[0] === ESTIMATED ? [6, 5] : [], label: here[0] === ESTIMATED ? `${name} (estimated)` : name });
    } else if (name !== S.marker) {
      const other = givenCircle(name, S.frame);
      if (other) drawn.push({ circle: other, colour: colourOf(name), label: name });
    }
  }
  for (const p of exact ? S.proposed : []) if (p.frame === S.frame) drawn.push({ circle: circleOf(p.circle), colour: "#ffffff", dash: [2, 4], label: p.colour });
  if (chair.open) { view.circle = null; drawn.length = 0; }
  view.drawn = drawn;
  chairDrawn(exact);
  view.draw();
  said();
}

/** @param {number[]} xyr */
const circleOf = ([x, y, r]) => ({ x, y, r });

function said() {
  const here = S.marker ? state(S.marker, S.frame) : null, circle = view.circle;
  const parts = [];
  if (here) {
    parts.push(`${S.marker}: ${S.session.statuses[here[0]]}`);
    if (here[2] !== null) parts.push(`${here[2].toFixed(3)} m away`);
    if (here[3] !== null) parts.push(`votes ${here[3].toFixed(2)} of 6`);
    if (here[4].length) parts.push(here[4].join("; "));
  } else if (S.marker) parts.push(S.session.kind === "recording" ? `${S.marker}: nothing is said of it here` : `${S.marker}: ${circle ? "circle" : "drag from its centre outwards, or press C"}`);
  $("state").textContent = parts.join(" · ");
  for (const k of ["x", "y", "r"]) if (document.activeElement !== $(k)) $(k).value = circle ? circle[k].toFixed(2) : "";
  const unsaved = S.drafts.has(key());
  $("in-hand").hidden = !circle || !unsaved;
  $("save").textContent = `${S.session.kind === "recording" ? "Save and track" : "Save circle"} (Enter)`;
  hint();
  facts();
}

/** What to do first, over the picture, as long as there is nothing. */
function hint() {
  if (chair.open) {
    const { name, what } = S.session.clicked.find((/** @type {any} */ one) => one.on === chair.on);
    $("hint").textContent = `${name}: click ${what}.`;
    $("hint").hidden = false;
    return;
  }
  const s = S.session, without = s.markers.find((/** @type {any} */ m) => !S.answers.some((a) => a.kind === "circle" && a.marker === m.name));
  let text = "";
  if (["video", "log"].includes(s.kind) && !S.drafts.size && S.job?.ended !== "") {
    if (S.proposed.length) text = "Keep what is a marker, in the list beside. What was proposed on this frame is drawn dotted.";
    else if (!s.markers.length) text = "Go to a frame that shows a marker, and drag from its centre outwards. Or press Propose markers.";
    else if (without && without.name === S.marker) text = `Drag from the centre of ${without.name} outwards, on a frame that shows it.`;
  }
  $("hint").textContent = text;
  $("hint").hidden = !text;
}

function facts() {
  const dl = $("facts"), snapped = S.snap;
  dl.replaceChildren();
  const doubt = snapped?.against.length ? `${snapped.against.join(", ")}: is it the marker?` : "";
  $("doubt").textContent = doubt;
  $("doubt").hidden = !doubt;
  if (!snapped || !view.circle) return;
  /** @param {string} term @param {string} text @param {boolean} [doubt] */
  const say = (term, text, doubt = false) => {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = term; dd.textContent = text; if (doubt) dd.className = "doubt";
    dl.append(dt, dd);
  };
  const [sx, sy, sr] = snapped.sd_px.map((/** @type {number | null} */ v) => v === null ? "?" : v.toFixed(2));
  say("Uncertainty", `± ${sx}, ${sy} px; radius ± ${sr} px`);
  say("Outline seen", `${Math.round(snapped.visible * 100)} %`, snapped.visible < 0.5);
  if (snapped.contrast !== null) say("Contrast", `${snapped.contrast.toFixed(0)} (2 is just seen)`, snapped.contrast < 10);
  if (snapped.distance_m !== null) say("Distance", `${snapped.distance_m.toFixed(3)} m ± ${(snapped.distance_sd_m * 1000).toFixed(0)} mm`);
  say("Colours select", `${snapped.selected} pixels around here`);
  if (doubt) say("But", doubt, true);
}

// --- the chair ---

const chair = new Chair({
  changed: () => { if (S.session) { chairList(); overlays(); remember(); } },
  saving: () => saved("saving", "Saving"),
  saved: () => { saved("done", `Saved ${new Date().toLocaleTimeString()} in ${S.session.chair_file}`); message(""); },
  failed: (error) => { saved("failed", "Not saved"); message(error.message); },
});

/** @param {boolean} open */
function openChair(open) {
  chair.open = open && S.session.chair_file !== null;
  chair.held = null;
  view.pointing = chair.open;
  document.body.classList.toggle("chair", chair.open);
  $("chair-in-hand").hidden = !chair.open;
  $("chair-open").setAttribute("aria-pressed", String(chair.open));
  $("chair-open").textContent = chair.open ? "Back to the markers (W)" : "Click its wheels (W)";
  $("chair-file").textContent = S.session.chair_file ?? "";
  if (chair.open) view.mask = null; else mask();
  chairList();
  overlays();
  remember();
}

/** @param {string} on */
const nameOf = (on) => S.session.clicked.find((/** @type {any} */ one) => one.on === on).name;

/** What a click is called: those of a rim have numbers. @param {import("./chair.js").Click[]} clicks @param {number} k */
function clickName(clicks, k) {
  const { on } = clicks[k];
  return on.endsWith("_rim") ? `${nameOf(on)} ${clicks.slice(0, k + 1).filter((click) => click.on === on).length}` : nameOf(on);
}

/** The points over the picture; a camera that is fixed to the chair has them on every frame. @param {boolean} exact */
function chairDrawn(exact) {
  const clicks = chair.open && exact ? chair.shown() : [];
  view.points = clicks.map((click, k) => {
    const chosen = chair.held ? (chair.held.k < 0 ? k === clicks.length - 1 : k === chair.held.k) : k === chair.chosen;
    const label = click.doubted ? `${clickName(clicks, k)}?` : chosen || !click.on.endsWith("_rim") ? clickName(clicks, k) : undefined;
    return { x: click.x_px, y: click.y_px, colour: CHAIR_COLOURS[click.on], chosen, faint: click.frame !== S.frame, label };
  });
  view.outlines = clicks.length ? Object.entries(chair.rims).filter(([, rim]) => rim.outline.length).map(([on, rim]) => ({ outline: rim.outline, colour: CHAIR_COLOURS[on] })) : [];
}

function chairList() {
  const there = $("clicked").querySelector("input:focus") !== null, listed = $("clicks").contains(document.activeElement), clicks = chair.clicks;
  $("clicked").replaceChildren(...S.session.clicked.map(({ on, name }) => {
    const label = document.createElement("label"), radio = document.createElement("input"), sign = document.createElement("span"), size = document.createElement("span");
    Object.assign(radio, { type: "radio", name: "clicked", value: on, checked: on === chair.on });
    radio.onchange = () => clickNext(on);
    sign.className = "chip"; sign.style.background = CHAIR_COLOURS[on];
    size.className = "size number"; size.textContent = String(clicks.filter((click) => click.on === on).length || "");
    label.append(radio, sign, name, size);
    return label;
  }));
  $("rims-said").replaceChildren(...Object.entries(chair.rims).filter(([, rim]) => rim.said).map(([on, rim]) => {
    const p = document.createElement("p");
    p.textContent = `${nameOf(on)}: ${rim.said}`;
    if (clicks.some((click) => click.on === on && click.doubted)) p.className = "doubt";
    return p;
  }));
  $("clicks").replaceChildren(...clicks.map((click, k) => {
    const item = document.createElement("li"), off = typeof click.off_px === "number" ? `, ${click.off_px.toFixed(2)} px off` : "";
    const where = button(`${clickName(clicks, k)}, frame ${click.frame}${off}${click.doubted ? ": is it on the rim?" : ""}`, () => { chair.choose(k); go(click.frame); });
    where.className = "go";
    where.title = `x ${click.x_px.toFixed(2)}, y ${click.y_px.toFixed(2)} px`;
    where.setAttribute("aria-current", String(k === chair.chosen));
    const back = button("✕", () => chair.remove(k));
    back.setAttribute("aria-label", `Take out: ${clickName(clicks, k)}`);
    item.append(where, back);
    return item;
  }));
  $("chair-undo").disabled = !chair.done.length;
  $("chair-remove").disabled = chair.chosen < 0;
  // What has the focus is made anew: it goes on where it was.
  if (there) $("clicked").querySelector("input:checked")?.focus();
  if (listed) ($("clicks").querySelector(".go[aria-current=true]") ?? $("clicks").querySelector(".go") ?? $("picture")).focus({ preventScroll: true });
  $("clicks").querySelector("[aria-current=true]")?.scrollIntoView({ block: "nearest" });
}

/** @param {string} on */
function clickNext(on) {
  chair.on = on;
  chair.choose(clickOf(on));
}

/** The one click on what has one, -1 for a rim. @param {string} on */
function clickOf(on) { return on.endsWith("_rim") ? -1 : chair.clicks.findIndex((click) => click.on === on); }

function zoomClick() {
  const click = chair.clicks[chair.chosen];
  if (click) view.zoomTo({ x: click.x_px, y: click.y_px, r: 8 }); else message("No click is chosen.");
}

/** What the keys mean while the chair is clicked; the others move through the frames and the picture as ever.
 * @param {KeyboardEvent} e @param {number} fine @param {number} way @returns {Record<string, () => void>} */
function chairKeys(e, fine, way) {
  const things = S.session.clicked.map((/** @type {any} */ one) => one.on), count = chair.clicks.length, none = () => {};
  /** @param {number} to */
  const turn = (to) => { if (count) chair.choose((to + count) % count); };
  const away = () => chair.remove();
  return {
    ...(e.shiftKey ? {
      ArrowLeft: () => chair.nudge(-fine, 0, S.frame), ArrowRight: () => chair.nudge(fine, 0, S.frame),
      ArrowUp: () => chair.nudge(0, -fine, S.frame), ArrowDown: () => chair.nudge(0, fine, S.frame),
    } : {}),
    "[": () => turn((chair.chosen < 0 ? count : chair.chosen) - 1), "]": () => turn(chair.chosen + 1),
    m: () => clickNext(things[(things.indexOf(chair.on) + way + things.length) % things.length]),
    c: () => { if (S.shown === S.frame) chair.hold(-1, S.frame, view.middle(), true); },
    u: () => chair.undo(), Backspace: away, Delete: away, z: zoomClick, Escape: () => openChair(false),
    x: none, Enter: none, h: none, k: none, y: none, a: none, d: none, r: none, s: none, l: none,
  };
}

// --- the circle in hand ---

/** @param {any} circle */
function draft(circle) {
  if (!circle) S.drafts.delete(key());
  else S.drafts.set(key(), { x: circle.x, y: circle.y, r: circle.r });
  S.snap = null; view.mask = null;
  overlays();
  remember();
}

async function snap() {
  const circle = view.circle, at = key(), frame = S.frame, marker = S.marker;
  if (!circle || S.shown !== S.frame) return;
  const found = await attempt(() => post("/snap", { marker, frame, circle: { x_px: circle.x, y_px: circle.y, r_px: circle.r } }));
  if (!found || key() !== at) return;
  const c = found.circle;
  if (S.drafts.has(at) || Math.abs(c.x_px - circle.x) + Math.abs(c.y_px - circle.y) + Math.abs(c.r_px - circle.r) > 1e-6) S.drafts.set(at, { x: c.x_px, y: c.y_px, r: c.r_px });
  S.snap = found;
  mask();
  overlays();
  remember();
}

function mask() {
  view.mask = null;
  if (!S.snap || !$("show-mask").checked) { view.draw(); return; }
  const image = new Image();
  image.onload = () => view.draw();
  image.src = S.snap.mask;
  view.mask = { image, window: S.snap.window };
}

function newCircle() {
  if (view.circle) return;
  const here = S.marker ? state(S.marker, S.frame) : null;
  const near = [...S.answers].filter((a) => a.kind === "circle" && a.marker === S.marker).sort((a, b) => Math.abs(a.frame - S.frame) - Math.abs(b.frame - S.frame))[0];
  if (here?.[1]) draft(circleOf(here[1]));
  else if (near) draft({ x: near.x_px, y: near.y_px, r: near.r_px });
  else draft({ x: Math.round(S.session.width / 2), y: Math.round(S.session.height / 2), r: Math.round(S.session.height / 20) });
}

/** Save an answer; on disk when the page says so. @param {any} answer */
async function answer(answer) {
  saved("saving", "Saving");
  try {
    const now = await post("/answer", { ...answer, author: $("author").value });
    takeAnswers(now);
    saved("done", `Saved ${new Date().toLocaleTimeString()} in ${S.session.seeds_file}`);
    message("");
    return true;
  } catch (error) {
    saved("failed", "Not saved");
    message(/** @type {Error} */ (error).message);
    return false;
  }
}

async function saveCircle() {
  const circle = S.drafts.get(key());
  if (!circle || S.shown !== S.frame) return;
  if (!S.marker && !(await addMarker())) return;
  const [marker, frame, at] = [S.marker, S.frame, key()];
  S.drafts.delete(`@${frame}`);
  if (!await answer({ kind: "circle", marker, frame, circle: { x_px: circle.x, y_px: circle.y, r_px: circle.r } })) { S.drafts.set(at, circle); return; }
  S.drafts.delete(at);
  remember();
  overlays();
  if (S.session.kind === "recording" && S.job?.ended !== "") trackAgain(marker, frame);
}

async function trackAgain(marker = S.marker, frame = S.frame) {
  await attempt(() => post("/track-again", { marker, frame }));
}

/** @param {number} first @param {number} last */
async function saveHidden(first, last) {
  if (!S.marker) { message("name the marker first"); return; }
  if (await answer({ kind: "hidden", marker: S.marker, frame: Math.min(first, last), to_frame: Math.max(first, last) })) setHiddenFrom(null);
}

/** @param {number | null} frame */
function setHiddenFrom(frame) {
  S.hiddenFrom = frame;
  line.span = frame === null ? null : { marker: S.marker, first: frame, last: frame };
  $("hidden").textContent = frame === null ? "From here (H)" : "To here (H)";
  if (frame === null) { $("hidden-from").value = $("hidden-to").value = ""; } else $("hidden-from").value = frame;
  line.draw();
  remember();
}

function hide() {
  if ($("hidden-from").value && $("hidden-to").value) { saveHidden(Number($("hidden-from").value), Number($("hidden-to").value)); return; }
  if (S.hiddenFrom === null) setHiddenFrom(S.frame);
  else saveHidden(S.hiddenFrom, S.frame);
}

async function keep() {
  const r = S.requests[S.request];
  if (!r) { message("choose a request first: keep is its answer"); return; }
  await answer({ kind: "keep", marker: r.marker, frame: r.first_unverified, to_frame: lastOf(r) });
}

// --- markers ---

function markers(refill = true) {
  const box = $("markers"), s = S.session;
  if (!s.markers.some((/** @type {any} */ m) => m.name === S.marker)) S.marker = s.markers[0]?.name ?? "";
  box.replaceChildren(...s.markers.map((/** @type {any} */ m, /** @type {number} */ k) => {
    const label = document.createElement("label"), radio = document.createElement("input");
    Object.assign(radio, { type: "radio", name: "marker", value: m.name, checked: m.name === S.marker });
    radio.onchange = () => choose(m.name);
    const size = document.createElement("span");
    size.className = "size number"; size.textContent = `${m.diameter_mm} mm`;
    label.append(radio, chip(k), m.name, size);
    return label;
  }));
  const fixed = ["recording", "attended"].includes(s.kind);
  for (const id of ["marker-name", "marker-diameter", "marker-save"]) $(id).disabled = fixed;
  $("marker-form").hidden = fixed;
  if (refill) form(S.marker);
  line.markers = s.markers.map((/** @type {any} */ m) => m.name);
  laneNames();
  line.draw();
}

function laneNames() {
  $("lane-names").replaceChildren(...line.rows().map(({ marker, trial }) => {
    const span = document.createElement("span");
    span.textContent = trial ? `${marker}, new` : marker; span.className = marker === S.marker ? "chosen" : "";
    return span;
  }));
}

/** A marker's sign: colour and shape. @param {number} k */
function chip(k) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 14 14"); svg.setAttribute("class", "chip"); svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", ["M7 1a6 6 0 1 1 0 12a6 6 0 1 1 0-12", "M1.5 1.5h11v11h-11z", "M7 0l7 7l-7 7l-7-7z", "M7 1l6.5 12h-13z"][k % 4]);
  path.setAttribute("fill", COLOURS[k % COLOURS.length]); path.setAttribute("stroke", "#333"); path.setAttribute("stroke-width", "1");
  svg.append(path);
  return svg;
}

/** @param {string} name */
function choose(name) {
  S.marker = name;
  markers();
  overlays();
  remember();
}

/** Show a marker in the form, or with "" an empty one for a new marker. @param {string} name */
function form(name) {
  const m = S.session.markers.find((/** @type {any} */ one) => one.name === name);
  $("marker-form").dataset.was = m ? name : "";
  if (document.activeElement !== $("marker-name")) $("marker-name").value = m ? name : freeName();
  if (document.activeElement !== $("marker-diameter")) $("marker-diameter").value = m ? m.diameter_mm : 40;
  const colours = $("marker-colour"), own = Array.isArray(m?.colour);
  colours.replaceChildren(new Option("not said", ""), ...(own ? [new Option(`hues ${m.colour.join(" to ")}`, JSON.stringify(m.colour))] : []), ...S.session.colours.map((/** @type {string} */ c) => new Option(c, JSON.stringify(c))));
  colours.value = m?.colour ? JSON.stringify(m.colour) : "";
  $("marker-save").textContent = m ? "Change" : "Add marker";
  $("marker-new").hidden = !m;
  $("marker-drop").hidden = !m || S.answers.some((a) => a.marker === name);
}

function freeName() {
  let k = 1;
  while (S.session.markers.some((/** @type {any} */ m) => m.name === `marker_${k}`)) k++;
  return `marker_${k}`;
}

async function addMarker() {
  const name = $("marker-name").value.trim(), was = $("marker-form").dataset.was || null;
  const s = await attempt(() => post("/marker", { name, diameter_mm: Number($("marker-diameter").value), was, colour: JSON.parse($("marker-colour").value || "null") }));
  if (!s) return false;
  for (const [k, circle] of [...S.drafts]) {
    if (k.startsWith(`${was ?? ""}@`)) { S.drafts.delete(k); S.drafts.set(`${name}@${k.split("@")[1]}`, circle); }
  }
  S.session = s; S.marker = name;
  if (was && was !== name) takeAnswers(await get("/answers"));
  markers(); overlays(); remember();
  saved("done", `Saved in ${s.settings_file}`);
  return true;
}

// --- answers and requests ---

/** @param {any} said */
function takeAnswers(said) {
  S.answers = said.answers; S.answersRevision = said.revision; S.unwritten = said.unwritten;
  line.answers = S.answers; line.draw();
  $("answers-count").textContent = `${S.answers.length}`;
  $("answers").replaceChildren(...[...S.answers].sort((a, b) => a.frame - b.frame || a.marker.localeCompare(b.marker)).map((a) => {
    const item = document.createElement("li");
    const what = a.kind === "circle" ? `circle on ${a.frame}` : a.kind === "hidden" ? `not visible ${a.frame}–${a.to_frame}` : `kept ${a.frame}–${a.to_frame}`;
    const where = button(`${a.marker}: ${what}${S.session.kind === "recording" && !a.written ? " (not in the recording yet)" : ""}`, () => { choose(a.marker); go(a.frame); });
    where.className = "go";
    where.title = [a.author, a.time].filter(Boolean).join(", ") || "no author noted";
    item.append(where);
    if (a.kind === "circle" && S.session.kind === "recording" && !a.written) {
      const again = button("Track", () => { choose(a.marker); go(a.frame); trackAgain(a.marker, a.frame); });
      again.setAttribute("aria-label", `Track ${a.marker} again from frame ${a.frame}`);
      item.append(again);
    } else item.append(document.createElement("span"));
    const back = button("✕", () => attempt(async () => takeAnswers(await post("/take-back", { kind: a.kind, marker: a.marker, frame: a.frame }))));
    back.setAttribute("aria-label", `Take back: ${a.marker}, ${what}`);
    back.title = "Take this answer back";
    item.append(back);
    return item;
  }));
  actions();
  overlays();
}

/** @param {string} text @param {() => void} act */
function button(text, act) {
  const b = document.createElement("button");
  b.type = "button"; b.textContent = text; b.onclick = act;
  return b;
}

async function takeLanes() {
  const said = await get("/lanes");
  S.lanesRevision = said.revision; S.lanes = said.lanes; S.requests = said.requests;
  line.lanes = said.lanes; line.requests = said.requests; line.knownTo = said.known_to;
  line.draw();
  const whole = said.known_to > S.session.last || S.session.kind !== "recording";
  $("reading").textContent = whole ? "" : `time line read up to frame ${said.known_to - 1}`;
  requests();
  overlays();
}

function requests() {
  $("requests").hidden = !["recording", "attended"].includes(S.session.kind);
  $("later").hidden = S.session.kind !== "attended";
  const open = S.requests.filter((r) => !r.answered).length;
  $("requests-left").textContent = S.requests.length ? `${open} of ${S.requests.length} open` : S.session.kind === "attended" ? "none now" : "none";
  $("request-list").replaceChildren(...S.requests.map((r, k) => {
    const item = document.createElement("li");
    const b = button(`${r.answered ? "✓ " : ""}${r.marker}, frame ${r.first_unverified}${r.end === null ? " to the end" : ` to ${r.end - 1}`}${r.answered ? " (answered)" : ""}`, () => select(k));
    b.className = r.answered ? "answered" : "";
    b.setAttribute("aria-current", String(k === S.request));
    item.append(b);
    return item;
  }));
  if (S.request >= S.requests.length) S.request = -1;
  $("request").hidden = S.request < 0;
  $("request-hint").hidden = S.request >= 0 || !open;
}

/** Open a request on its first unverified frame. @param {number} k */
async function select(k) {
  S.request = k;
  const r = S.requests[k];
  requests();
  choose(r.marker);
  go(r.first_unverified);
  $("request-words").textContent = r.words;
  $("hide-all").textContent = `Not visible ${r.first_unverified}–${lastOf(r)}`;
  const from = r.last_verified ?? r.first_unverified, to = Math.min(S.session.last, r.end ?? r.raised + 30);
  const said = await statesOf(Math.max(S.session.first, from), Math.min(to, from + 900));
  const states = said.states[r.marker] ?? [];
  /** @param {number} frame */
  const circleAt = (frame) => { for (let f = frame; f >= said.first; f--) { const c = states[f - said.first]?.[1]; if (c) return c; } return null; };
  const seen = circleAt(from) ?? r.circle ?? [S.session.width / 2, S.session.height / 2, S.session.height / 8];
  /** @param {HTMLImageElement} image @param {number} frame @param {string} alt */
  const crop = (image, frame, alt) => {
    const c = circleAt(frame) ?? seen;
    const [x, y] = [Math.min(Math.max(c[0], 0), S.session.width), Math.min(Math.max(c[1], 0), S.session.height)];
    image.src = `/crop/${frame}?x=${Math.round(x)}&y=${Math.round(y)}&half=${Math.max(12, Math.round(seen[2] * 3.5))}`;
    image.alt = alt;
  };
  $("last-verified").parentElement.disabled = r.last_verified === null;
  if (r.last_verified !== null) crop($("last-verified"), r.last_verified, `${r.marker} on frame ${r.last_verified}, last verified`);
  crop($("first-unverified"), r.first_unverified, `${r.marker} on frame ${r.first_unverified}, first unverified`);
  $("last-caption").textContent = r.last_verified === null ? "never verified before" : `last verified: ${r.last_verified}`;
  $("first-caption").textContent = `first unverified: ${r.first_unverified}`;
  const wanted = [...new Set(Array.from({ length: 10 }, (_, n) => Math.round(from + (to - from) * n / 9)))];
  $("strip").replaceChildren(...wanted.map((frame) => {
    const b = button("", () => go(frame)), image = document.createElement("img"), holder = document.createElement("div");
    holder.setAttribute("role", "listitem");
    crop(image, frame, `frame ${frame}`);
    b.append(image, String(frame));
    holder.append(b);
    return holder;
  }));
}

/** The last frame that a request is about: nobody knows yet what comes of a run behind the one it waits on. @param {any} r */
function lastOf(r) { return S.session.kind === "attended" ? r.raised : (r.end ?? S.session.last + 1) - 1; }

function actions() {
  const s = S.session, busy = S.job?.ended === "";
  $("track").hidden = ["recording", "attended"].includes(s.kind);
  $("track").disabled = busy || !S.answers.some((a) => a.kind === "circle");
  $("track").classList.toggle("main", !s.written);
  $("propose").hidden = $("track").hidden; $("propose").disabled = busy;
  $("write").hidden = s.kind !== "recording" || !S.unwritten;
  $("write").disabled = busy;
  $("write").textContent = `Write new recording (${S.unwritten} answer${S.unwritten === 1 ? "" : "s"})`;
  $("open-written").hidden = !s.written || busy;
  $("open-written").textContent = `Open ${s.written ?? ""}`;
}

// --- jumps ---

/** @param {number} way 1 on, -1 back */
function jumpDoubtful(way) {
  /** @type {[number, string][]} */ const starts = [];
  for (const [marker, runs] of Object.entries(S.lanes)) {
    runs.forEach(([start, code], k) => { if ((code === ESTIMATED || code === LOST) && ![ESTIMATED, LOST].includes(runs[k - 1]?.[1] ?? NONE)) starts.push([start, marker]); });
  }
  jump(starts, way, "no doubtful frame", (marker) => choose(marker));
}

/** @param {number} way */
function jumpAnswer(way) { jump(S.answers.map((a) => [a.frame, a.marker]), way, "no answer yet", (marker) => choose(marker)); }

/** @param {number} way */
function jumpRequest(way) {
  const open = S.requests.map((r, k) => [r.first_unverified, k]).filter(([, k]) => !S.requests[k].answered);
  jump(/** @type {any} */ (open), way, "no open request", (k) => select(k));
}

/** To the nearest place before or behind this frame, around the end. @template T @param {[number, T][]} places @param {number} way
 * @param {string} none @param {(what: T) => void} act */
function jump(places, way, none, act) {
  if (!places.length) { message(`There is ${none}.`); return; }
  const sorted = [...places].sort((a, b) => (a[0] - b[0]) * way);
  const next = sorted.find(([frame]) => (frame - S.frame) * way > 0) ?? sorted[0];
  message("");
  act(next[1]);
  go(next[0]);
}

// --- proposals ---

/** What is left to be kept or thrown away. @param {any[]} left */
function propose(left) {
  S.proposed = left;
  $("proposals").hidden = !left.length;
  overlays();
}

async function takeProposals() {
  const said = await attempt(() => get("/proposals"));
  if (!said) return;
  propose(said.said);
  if (said.said.length) go(said.said[0].frame);
  const taken = new Set(S.session.markers.map((/** @type {any} */ m) => m.name));
  $("proposal-list").replaceChildren(...said.said.map((/** @type {any} */ p) => {
    const item = document.createElement("li"), image = document.createElement("img"), box = document.createElement("div");
    image.src = `/crop/${p.frame}?x=${Math.round(p.circle[0])}&y=${Math.round(p.circle[1])}&half=${Math.max(8, Math.round(p.circle[2] * 2))}`;
    image.alt = `a ${p.colour} sphere on frame ${p.frame}`;
    const words = document.createElement("p"), name = document.createElement("input");
    words.textContent = p.reason;
    const colour = `${p.colour}`.replace(/[^A-Za-z0-9_]/g, "_");
    let free = colour;
    for (let k = 2; taken.has(free); k++) free = `${colour}_${k}`;
    taken.add(free);
    Object.assign(name, { type: "text", value: free, maxLength: 100 });
    name.setAttribute("aria-label", "Name of this marker");
    const row = document.createElement("div");
    row.className = "row";
    const done = () => { item.remove(); propose(S.proposed.filter((one) => one !== p)); };
    row.append(button("Keep", async () => {
      const marker = name.value.trim();
      const s = await attempt(() => post("/marker", { name: marker, diameter_mm: Number($("marker-diameter").value) || 40, was: null, colour: S.session.colours.includes(p.colour) ? p.colour : null }));
      if (!s) return;
      S.session = s;
      if (await answer({ kind: "circle", marker, frame: p.frame, circle: { x_px: p.circle[0], y_px: p.circle[1], r_px: p.circle[2] } })) { done(); choose(marker); go(p.frame); }
    }), button("Throw away", done), button("Show", () => { go(p.frame); view.zoomTo(circleOf(p.circle)); }));
    box.append(name, row, words);
    item.append(image, box);
    return item;
  }));
}

// --- the trial ---

async function takeTrial() {
  S.trial = await get("/trial");
  S.blocks.clear();
  $("trial").hidden = !S.trial;
  if (S.trial) {
    const t = S.trial;
    line.span = { marker: t.answer.marker, first: t.first, last: t.last };
    $("trial-said").textContent = `${t.answer.marker} tracked again on frames ${t.first} to ${t.last}: measured on ${t.measured_new} of them, before on ${t.measured_old}. It begins: ${t.before}. It ends: ${t.after}. Nothing is replaced yet.`;
    $("trial-doubt").hidden = 2 * t.measured_new >= t.measured_old; // a wrong track is measured on many frames too
  } else if (S.hiddenFrom === null) line.span = null;
  line.trial = S.trial && { marker: S.trial.answer.marker, runs: S.trial.runs };
  laneNames();
  line.draw();
  overlays();
}

async function accept() { if (S.trial) { await attempt(() => post("/accept")); await takeTrial(); } }

async function discard() {
  if (!S.trial) return;
  const back = await attempt(() => post("/discard"));
  if (!back) return;
  await takeTrial();
  const a = back.said;
  S.marker = a.marker;
  go(a.frame);
  takeAnswers(await get("/answers"));
  draft({ x: a.x_px, y: a.y_px, r: a.r_px });
  saved("done", "Taken back; the circle is in your hand again");
}

// --- what comes by itself ---

async function listen() {
  let mark = "";
  for (;;) {
    try {
      const now = await get(`/pulse?seen=${mark}`);
      if (now.shows !== S.session.shows) { await boot(); mark = now.mark; continue; }
      mark = now.mark;
      job(now.job);
      if (now.written !== S.session.written) { S.session.written = now.written; }
      if (now.answers !== S.answersRevision) { takeAnswers(await get("/answers")); S.session = await get("/session"); markers(!$("marker-form").contains(document.activeElement)); }
      if (now.lanes !== S.lanesRevision || now.answers !== S.seenByLanes) { S.seenByLanes = now.answers; await takeLanes(); }
      if (now.chair !== chair.revision && S.session.chair_file !== null) await chair.fetch();
      if (now.trial !== Boolean(S.trial)) await takeTrial();
      if (S.session.kind === "attended" && now.asked !== S.asked) await question(now.asked);
      actions();
      if (lost) { lost = false; message(""); }
    } catch (error) {
      lost = true;
      if (!(error instanceof TypeError)) message(/** @type {Error} */ (error).message); // it answered: the program is there
      else message(S.session.kind === "attended" ? "The run has ended: the terminal says how. All answers are in the seeds file." : "The page has lost its program. All that it said is saved is on disk: start `spheremcap annotate` again.");
      await new Promise((done) => setTimeout(done, 1500));
    }
  }
}
let lost = false;

/** A run that is going on waits for an answer, or goes on. @param {number} asked */
async function question(asked) {
  const open = S.request === 0 && S.asked === 0; // a reload has brought it back
  S.asked = asked;
  await takeLanes();
  if (asked) { saved("saving", "Tracking waits for your answer"); if (!open) await select(0); }
  else { S.request = -1; requests(); saved("done", "Tracking goes on; the next question comes by itself"); }
}

/** @param {any} now */
function job(now) {
  const ended = S.job && now.ended !== "" && (S.job.ended === "" || S.job.number !== now.number);
  S.job = now;
  $("job").hidden = now.ended !== "";
  $("job-name").textContent = now.name;
  if (now.total) { $("job-bar").max = now.total; $("job-bar").value = Math.min(now.done, now.total); } else $("job-bar").removeAttribute("value");
  $("job-count").textContent = now.done ? `${now.done}${now.total ? ` of ${now.total}` : ""}` : "";
  if (ended) {
    if (now.ended === "failed") message(now.said);
    else saved("done", now.said);
    if (now.name === "looking for markers") takeProposals();
  }
}

/** What a reload brings back. */
function remember() {
  sessionStorage.setItem("at", JSON.stringify({ shows: S.session.shows, frame: S.frame, marker: S.marker, request: S.request, hiddenFrom: S.hiddenFrom, drafts: [...S.drafts], chair: chair.open, on: chair.on }));
}

async function boot() {
  const s = await get("/session");
  const again = S.session !== null;
  S.session = s;
  pictures.forget();
  S.blocks.clear(); S.lanes = {}; S.requests = []; S.request = -1; S.lanesRevision = -2; S.trial = null; S.shown = -1; S.asked = 0;
  propose([]);
  document.title = `${s.name} – spheremcap`;
  $("name").textContent = s.name;
  for (const one of document.querySelectorAll(".tracked")) /** @type {HTMLElement} */ (one).hidden = !["recording", "attended"].includes(s.kind);
  $("camera-choice").hidden = s.cameras.length < 2;
  $("camera-name").replaceChildren(...s.cameras.map((/** @type {string} */ c) => new Option(c, c, false, c === s.camera_name)));
  $("kind").textContent = { video: "video", log: "recording without markers", recording: "tracked recording", attended: "is being tracked" }[/** @type {"video"} */ (s.kind)];
  $("seeds-file").textContent = s.seeds_file;
  if (!again) $("author").value = localStorage.getItem("author") ?? s.author;
  $("frame").min = s.first; $("frame").max = s.last;
  $("lanes").setAttribute("aria-valuemin", s.first); $("lanes").setAttribute("aria-valuemax", s.last);
  const preset = $("preset");
  preset.replaceChildren(new Option(s.camera.given && !s.camera.preset ? "own calibration" : "none given", ""), ...s.camera.presets.map((/** @type {string} */ p) => new Option(p, p)));
  camera();
  view.of(s.width, s.height);
  line.of(s.first, s.last);
  let was = null;
  try { was = JSON.parse(sessionStorage.getItem("at") ?? "null"); } catch { /* nothing to come back to */ }
  if (was?.shows === s.shows) { S.marker = was.marker; S.drafts = new Map(was.drafts); S.request = was.request; }
  else { S.drafts = new Map(); was = null; }
  markers();
  takeAnswers(await get("/answers"));
  setHiddenFrom(was?.hiddenFrom ?? null);
  await takeLanes();
  await takeTrial();
  $("chair").hidden = s.chair_file === null;
  chair.forget();
  if (s.chair_file !== null) await chair.fetch();
  if (was?.on) chair.on = was.on;
  openChair(Boolean(was?.chair));
  const first = S.answers.filter((a) => a.kind === "circle").map((a) => a.frame).sort((a, b) => a - b)[0];
  go(was?.frame ?? first ?? s.first);
  if (S.request >= 0 && S.requests[S.request]) { const at = S.frame; await select(S.request); go(at); }
}

function camera() {
  const c = S.session.camera, fixed = ["recording", "attended"].includes(S.session.kind);
  const metres = c.metric ? (c.focal_sd ? `Distances are good to about ${(c.focal_sd * 100).toFixed(1)} %.` : "Distances rest on this calibration.") : "Circles are had, metres are not.";
  $("camera-note").textContent = `${c.note[0].toUpperCase()}${c.note.slice(1)}. ${metres}${fixed ? " It is the one that the recording was tracked with." : ""}`;
  $("preset").value = c.preset ?? "";
  $("preset").disabled = $("calibration").disabled = fixed;
}

// --- hands ---

const on = (/** @type {string} */ id, /** @type {() => void} */ act) => { $(id).onclick = act; };
on("back", () => go(S.frame - 1)); on("forward", () => go(S.frame + 1));
on("back-10", () => go(S.frame - 10)); on("forward-10", () => go(S.frame + 10));
on("next-doubtful", () => jumpDoubtful(1)); on("next-request", () => jumpRequest(1)); on("next-seed", () => jumpAnswer(1));
on("zoom-in", () => view.zoom(1.5)); on("zoom-out", () => view.zoom(1 / 1.5)); on("zoom-fit", () => view.fit());
on("zoom-circle", () => { if (chair.open) zoomClick(); else zoomCircle(); });
on("snap", snap); on("save", saveCircle); on("clear", () => draft(null));
on("accept", accept); on("discard", discard);
on("stop", () => attempt(() => post("/stop")));
on("track", () => attempt(() => post("/track"))); on("write", () => attempt(() => post("/write")));
on("open-written", () => attempt(() => post("/open-written")));
on("propose", () => attempt(() => post("/propose")));
on("give-circle", newCircle); on("later", () => attempt(() => post("/later")));
on("hide-all", () => { const r = S.requests[S.request]; if (r) saveHidden(r.first_unverified, lastOf(r)); }); on("keep", keep);
on("see-last", () => { const r = S.requests[S.request]; if (r?.last_verified !== null) go(r.last_verified); });
on("see-first", () => go(S.requests[S.request].first_unverified));
on("chair-open", () => openChair(!chair.open)); on("chair-undo", () => chair.undo()); on("chair-remove", () => chair.remove());
on("help", () => $("keys").showModal());
on("line-in", () => line.zoom(0.5)); on("line-out", () => line.zoom(2));
on("marker-new", () => { $("marker-form").dataset.was = ""; $("marker-name").value = freeName(); $("marker-colour").value = ""; $("marker-save").textContent = "Add marker"; $("marker-drop").hidden = $("marker-new").hidden = true; $("marker-name").focus(); });
on("marker-drop", () => attempt(async () => { S.session = await post("/drop-marker", { marker: S.marker, frame: 0 }); markers(); overlays(); }));
$("marker-form").onsubmit = (/** @type {Event} */ e) => { e.preventDefault(); addMarker(); };
$("hidden-form").onsubmit = (/** @type {Event} */ e) => { e.preventDefault(); hide(); };
$("show-mask").onchange = () => { if (S.snap) mask(); else snap(); };
$("author").onchange = () => localStorage.setItem("author", $("author").value);
$("frame").onchange = () => { go(Number($("frame").value)); };
$("time").onchange = async () => {
  const parts = $("time").value.trim().replace(",", ".").split(":").map(Number);
  const seconds = parts.reduce((/** @type {number} */ sum, /** @type {number} */ part) => sum * 60 + part, 0);
  const found = await attempt(() => get(`/time?seconds=${seconds}`));
  if (found) go(found.frame);
};
for (const k of ["x", "y", "r"]) $(k).onchange = () => {
  const c = view.circle ?? { x: S.session.width / 2, y: S.session.height / 2, r: S.session.height / 20 };
  const value = Number($(k).value);
  if (Number.isFinite(value) && $(k).value !== "") draft({ ...c, [k]: k === "r" ? Math.max(1, value) : value });
};
$("camera-name").onchange = () => attempt(async () => {
  try { await post("/camera", { name: $("camera-name").value }); } finally { $("camera-name").value = S.session.camera_name; }
});
$("preset").onchange = () => attempt(async () => { S.session = await post("/preset", { preset: $("preset").value || null }); camera(); });
$("calibration").onchange = () => attempt(async () => {
  const [file] = $("calibration").files;
  if (file) { S.session = await send("/calibration", file); $("preset").options[0].text = "own calibration"; camera(); }
});

function zoomCircle() {
  const here = S.marker ? state(S.marker, S.frame) : null;
  const circle = view.circle ?? (here?.[1] ? circleOf(here[1]) : null);
  if (circle) view.zoomTo(circle); else message("There is no circle on this frame.");
}

/** @param {number} dx @param {number} dy @param {number} dr */
function nudge(dx, dy, dr) {
  const c = view.circle;
  if (c) draft({ x: c.x + dx, y: c.y + dy, r: Math.max(1, c.r + dr) });
}

document.addEventListener("keydown", (e) => {
  const target = /** @type {HTMLElement} */ (e.target);
  if (e.key === " " && (target === document.body || target === $("picture"))) { view.space = true; e.preventDefault(); return; }
  if ($("keys").open) return;
  const typing = target instanceof HTMLInputElement && !["radio", "checkbox"].includes(target.type) || target instanceof HTMLSelectElement;
  if (typing) { if (e.key === "Escape") target.blur(); if (e.key === "Enter" && ["frame", "time", "x", "y", "r"].includes(target.id)) target.blur(); return; }
  if (chair.open && (e.ctrlKey || e.metaKey) && e.key === "z") { e.preventDefault(); chair.undo(); return; }
  if (e.ctrlKey || e.metaKey || !S.session) return;
  const fine = e.altKey ? 0.1 : 1, radio = target instanceof HTMLInputElement && target.type === "radio";
  const press = target instanceof HTMLButtonElement && (e.key === "Enter" || e.key === " ");
  if (press || (radio && e.key.startsWith("Arrow"))) return;
  const way = e.shiftKey ? -1 : 1;
  /** @type {Record<string, () => void>} */
  const keys = {
    ArrowLeft: () => e.shiftKey ? nudge(-fine, 0, 0) : go(S.frame - 1), ArrowRight: () => e.shiftKey ? nudge(fine, 0, 0) : go(S.frame + 1),
    ArrowUp: () => e.shiftKey && nudge(0, -fine, 0), ArrowDown: () => e.shiftKey && nudge(0, fine, 0),
    1: () => go(S.frame - 1), 2: () => go(S.frame + 1), PageUp: () => go(S.frame - 10), PageDown: () => go(S.frame + 10),
    Home: () => go(S.session.first), End: () => go(S.session.last),
    "[": () => nudge(0, 0, -fine), "]": () => nudge(0, 0, fine),
    g: () => { $("frame").focus(); $("frame").select(); }, t: () => { $("time").focus(); $("time").select(); },
    d: () => jumpDoubtful(way), r: () => jumpRequest(way), s: () => jumpAnswer(way),
    m: () => { const names = S.session.markers.map((/** @type {any} */ m) => m.name); if (names.length) choose(names[(names.indexOf(S.marker) + way + names.length) % names.length]); },
    l: () => { if (S.session.kind === "attended") $("later").click(); },
    c: newCircle, x: snap, Enter: saveCircle, h: hide, k: keep, y: () => trackAgain(), a: accept,
    Escape: () => { if (S.trial) discard(); else if (S.hiddenFrom !== null) setHiddenFrom(null); }, Backspace: () => draft(null), Delete: () => draft(null),
    "+": () => view.zoom(1.5), "=": () => view.zoom(1.5), "-": () => view.zoom(1 / 1.5), 0: () => view.fit(), z: zoomCircle, "?": () => $("keys").showModal(),
    w: () => openChair(!chair.open), ...(chair.open ? chairKeys(e, fine, way) : {}),
  };
  const act = keys[e.key] ?? keys[e.key.toLowerCase()] ?? { BracketLeft: keys["["], BracketRight: keys["]"] }[e.code];
  if (act) { e.preventDefault(); act(); }
});
// A button that the mouse has pressed does not keep the keys: Enter goes on to mean the circle.
document.addEventListener("click", (e) => {
  const pressed = e.detail > 0 && /** @type {HTMLElement} */ (e.target).closest("button");
  if (pressed && document.activeElement === pressed) $("picture").focus({ preventScroll: true });
});
document.addEventListener("keyup", (e) => { if (e.key === " ") view.space = false; });

boot().then(listen, (error) => message(error.message));
