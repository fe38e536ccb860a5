"use strict";
// What the page does: it hands numbers to the engine and draws what comes back. The engine decides
// what is refused and computes all figures; offsets, names, limits and texts come with the page.
const SCREEN = JSON.parse(document.getElementById("screen").textContent);
const { commands: DO, controls: CONTROLS, points: POINTS, unit: UNIT } = SCREEN;
const DECKS = SCREEN.lengths.length, CLASSES = SCREEN.edges.length - 1;
const byId = (id) => document.getElementById(id);
const all = (selector) => [...document.querySelectorAll(selector)];
const sum = (values) => values.reduce((total, x) => total + x, 0);
const sums = (values) => values.reduce((found, x) => [...found, found.at(-1) + x], [0]);

// --- texts, as Python writes them ---------------------------------------------------------------
function general(x, digits) {
  // Python's format(x, ".6g").
  if (!Number.isFinite(x)) return Number.isNaN(x) ? "nan" : x > 0 ? "inf" : "-inf";
  const [mantissa, power] = x.toExponential(digits - 1).split("e");
  const short = (text) => (text.includes(".") ? text.replace(/\.?0+$/, "") : text);
  if (power >= -4 && power < digits) return short(x.toFixed(Math.max(0, digits - 1 - power)));
  return `${short(mantissa)}e${power[0]}${power.slice(1).padStart(2, "0")}`;
}

function told(text, about) {
  return text.replace(/\{(\w+)(?::\.(\d+)g)?\}/g, (_, name, digits) =>
    digits ? general(about[name], Number(digits)) : about[name]);
}

function refusal(buffer) {
  // What the engine refused, as Python tells it of a file: names and units of its keys.
  const { code, index: place, value, limit } = buffer.record("refusal");
  const key = SCREEN.refused[code - 1], index = place - buffer.about.settings[0];
  if (key === "bad_sum") return { index, text: told(SCREEN.texts[key], { value, limit }) };
  const number = buffer.settings[index], said = SCREEN.settings[index];
  const shown = value / said.factor, plain = ["too_steep", "body_stays"].includes(key);
  const { name, factor } = SCREEN.settings[buffer.at("input", "motion_amplitude")];
  const slope = key === "too_steep" ? value : buffer.settings[buffer.at("panel", "inclination")];
  const given = `${said.name} = ${general(number / said.factor, 6)}`;
  const other = `${name} = ${general(buffer.record("input").motion_amplitude / factor, 6)}`;
  const far = Math.abs(value) > SCREEN.far * Math.max(Math.abs(said.least), Math.abs(said.most)) ||
    value < said.least / SCREEN.far;
  const meant = said.others.find(({ factor: unit }) =>
    shown * unit >= said.least && shown * unit <= said.most);
  const cure = far && meant && key.startsWith("too_")
    ? told(meant.question, { value: shown, meant: (shown * meant.factor) / said.factor }) : said.cure;
  return { index, text: told(SCREEN.texts[key], {
    name: said.name, unit: said.unit, range: said.range, given, other, cure, number,
    value: plain ? value : shown, limit: plain ? limit : limit / said.factor,
    degrees: (slope * 180) / Math.PI, slope: Math.tan(slope),
  }) };
}

function alarms(buffer) {
  return SCREEN.alarms.flatMap((name, k) => {
    const { reason, deck: number, value, limit, other } = buffer.record("alarm", k);
    const about = { number, value, limit, other_limit: other, slope: Math.tan(value) };
    about.degrees = (value * 180) / Math.PI;
    return reason > 0 ? [`${name}: ${told(SCREEN.texts[SCREEN.reasons[reason - 1]], about)}`] : [];
  });
}

// --- the engine ---------------------------------------------------------------------------------
class Buffer {
  // A screen in the memory of the engine; names and offsets as in kernels/state.py.
  constructor(engine, place, about, head, table) {
    Object.assign(this, { engine, place, about, table });
    this.numbers = new Float64Array(engine.memory.buffer, place, about.size);
    this.numbers.set(new Float64Array(head));
    this.settings = this.numbers.subarray(...about.settings);
  }
  run(command, first = 0, second = 0) {
    const size = BigInt(this.about.size);
    return Number(this.engine.vibroscreen_run(this.place, size, BigInt(command), first, second));
  }
  plan() {
    // What follows from the settings: velocities of the table, sizes inside the classes.
    const rows = [this.table.length / 16, this.table.length / 16].map(BigInt);
    const [one, two] = [this.table.place, this.table.place + this.table.length / 2];
    return Number(this.engine.vibroscreen_plan(
      this.place, BigInt(this.about.size), one, rows[0], two, rows[1]));
  }
  at(name, field, row = 0) {
    // Place of a number among the settings.
    const names = SCREEN.records[name];
    return this.about.at[name] - this.about.settings[0] + row * names.length + names.indexOf(field);
  }
  view(name, size, row = 0) {
    const start = this.about.at[name] + row * size;
    return this.numbers.subarray(start, start + size);
  }
  record(name, row = 0) {
    const names = SCREEN.records[name], values = this.view(name, names.length, row);
    return Object.fromEntries(names.map((one, k) => [one, values[k]]));
  }
  extent(name) {
    return this.numbers[this.about.dimension.indexOf(name)];
  }
  nodes(name, row = 0) {
    return this.view(name, this.extent("nodes"), row);
  }
  clear(name) {
    this.numbers.fill(0, ...this.about[name]);
  }
}

async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(plain).arrayBuffer();
}

let steady, running; // two buffers: one slice of the bed, and all of it
let wanted; // parameters and inputs as the fields say them

async function load() {
  const [code, ...heads] = await Promise.all(
    [SCREEN.engine, SCREEN.steady.head, SCREEN.running.head].map(unpacked));
  const { exports: engine } = (await WebAssembly.instantiate(code)).instance;
  const table = new Float64Array(SCREEN.table.flat());
  const sizes = [table.length, SCREEN.steady.size, SCREEN.running.size];
  const places = sums(sizes.map((size) => Math.ceil(size / 8) * 64))
    .map((place) => place + Math.ceil(engine.__heap_base.value / 64) * 64);
  const missing = places.at(-1) - engine.memory.buffer.byteLength;
  if (missing > 0) engine.memory.grow(Math.ceil(missing / 65536));
  new Float64Array(engine.memory.buffer, places[0]).set(table);
  const rows = { place: places[0], length: table.byteLength };
  steady = new Buffer(engine, places[1], SCREEN.steady, heads[0], rows);
  running = new Buffer(engine, places[2], SCREEN.running, heads[1], rows);
  wanted = steady.settings.slice();
}

function solve() {
  // Steady state under what is wanted; throws what is refused.
  steady.settings.set(wanted);
  if (steady.plan()) throw refusal(steady);
  steady.clear("seen"); // the sizes may be others: all is new
  if (steady.run(DO.SOLVE)) throw refusal(steady);
  const seen = read(steady);
  steady.run(DO.START_SLICE);
  seen.decks.forEach((deck, d) => follow(deck, d));
  return seen;
}

// --- a screen that runs -------------------------------------------------------------------------
let accepted = null; // its settings; null before it has begun
let clock = 0, history = [];

function begin() {
  // Start anew with what is wanted; throws what is refused, and all is as before then.
  steady.settings.set(wanted);
  if (steady.plan() || steady.run(DO.START_SLICE)) throw refusal(steady);
  running.settings.set(wanted);
  running.plan();
  running.clear("outputs");
  running.clear("state");
  running.run(DO.INITIALISE);
  accepted = running.settings.slice();
  [clock, history] = [0, []];
}

function advance(duration) {
  // Let time go on. A change that is refused is left out, and thrown afterwards.
  running.settings.set(wanted);
  const velocity = running.at("parameter", "passage_velocity"); // a table's is not in the fields
  running.settings[velocity] = accepted[velocity];
  let refused = null;
  if (running.run(DO.ADVANCE, duration)) {
    refused = refusal(running);
    running.settings.set(accepted);
    running.run(DO.ADVANCE, duration);
  }
  running.run(DO.READ);
  accepted = running.settings.slice();
  clock += duration;
  if (refused) throw refused;
}

// --- what comes back ----------------------------------------------------------------------------
function read(buffer) {
  // Figures, streams, partition and alarms; how the bed lies is still to be filled in.
  const output = buffer.record("output"), size = buffer.nodes("size");
  const stream = (rate, fraction, p80, p50) => ({ rate, p80, p50, passing: sums([...fraction]) });
  const fed = buffer.record("input").feed_mass_flow_rate;
  const between = Array.from({ length: DECKS - 1 }, (_, k) => {
    const { rate, p80, p50 } = buffer.record("intermediate", k);
    return stream(rate, buffer.view("intermediate_fraction", CLASSES, k), p80, p50);
  });
  const products = [
    stream(fed, buffer.view("fraction", CLASSES), output.feed_p80, output.feed_p50),
    stream(output.undersize_rate, buffer.view("undersize_fraction", CLASSES),
      output.undersize_p80, output.undersize_p50),
    ...between.reverse(),
    stream(output.oversize_rate, buffer.view("oversize_fraction", CLASSES),
      output.oversize_p80, output.oversize_p50),
  ];
  const decks = SCREEN.lengths.map((lengths, d) => {
    const figures = buffer.record("deck_result", d);
    const under = buffer.nodes("step_mass", d), over = buffer.nodes("step_mass", DECKS + d);
    const come = d ? buffer.nodes("step_mass", d - 1) : buffer.nodes("feed_fraction").map((x) => x * fed);
    const there = [...size.keys()].filter((i) => under[i] + over[i] > 0);
    const partition = [there.map((i) => size[i] * 1e3),
      there.map((i) => (100 * over[i]) / (under[i] + over[i]))];
    const places = Array.from({ length: POINTS }, (_, k) => (sum(lengths) * k) / (POINTS - 1));
    return { figures, partition, places, passed: [], bed: [], fine: finer(size, come, figures.aperture) };
  });
  return { output, products, decks, alarms: alarms(buffer) };
}

function finer(size, mass, aperture) {
  let total = 0;
  for (let i = 0; i < size.length && size[i] < aperture; i++) total += mass[i];
  return total;
}

function follow(deck, d) {
  // Let the slice of a deck ride from the feed end to the discharge, as Python's profiles do.
  if (d) steady.run(DO.START_BELOW, d);
  const ends = sums(SCREEN.lengths[d]), panels = steady.extent("panels");
  const speeds = SCREEN.lengths[d].map((_, p) => steady.record("scene", d * panels + p).transport_velocity);
  const times = sums(SCREEN.lengths[d].map((length, p) => length / speeds[p]));
  const flow = steady.view("width", 1, d)[0] * speeds[0];
  let before = 0, panel = 0;
  for (const place of deck.places) {
    while (panel + 1 < speeds.length && place > ends[panel + 1]) panel++;
    const moment = times[panel] + (place - ends[panel]) / speeds[panel];
    if (moment > before) steady.run(DO.FOLLOW, moment - before, d);
    before = moment;
    const passed = finer(steady.nodes("size"), steady.nodes("lead_passed", d), deck.figures.aperture);
    deck.passed.push(Math.min(100, (100 * flow * passed) / deck.fine));
    deck.bed.push(layers(steady, "lead", d, deck));
  }
}

function layers(buffer, name, row, deck) {
  // What lies at a place, from the screen up: depth of each layer, m, and share of a size in it, %.
  const nodes = buffer.extent("nodes"), most = buffer.extent("layers");
  const load = buffer.view(name, nodes * most, row), size = buffer.nodes("size");
  const density = buffer.record("parameter").material_bulk_density, found = [];
  const chosen = Number(byId("map-size").value);
  const [low, high] = chosen < 0 ? [0, deck.figures.aperture] : SCREEN.edges.slice(chosen, chosen + 2);
  for (let j = 0; j < most; j++) {
    const mass = load.subarray(j * nodes, (j + 1) * nodes), whole = finer(size, mass, Infinity);
    if (whole <= 0) continue;
    const part = finer(size, mass, high) - finer(size, mass, low);
    found.push([whole / density, (100 * part) / whole]);
  }
  return found;
}

function watch() {
  // The running screen at this moment.
  const seen = read(running);
  seen.decks.forEach((deck, d) => {
    for (const place of deck.places) {
      running.run(DO.READ_BED, place, d);
      deck.bed.push(layers(running, "column_time", 0, deck));
    }
  });
  if (history.at(-1)?.[0] !== clock) history.push([clock, ...seen.products.map((one) => one.rate / UNIT.rate)]);
  if (history.length > 600) history = history.slice(-500);
  seen.time = seen.products.map((_, k) => [history.map((row) => row[0]), history.map((row) => row[k + 1])]);
  return seen;
}

// --- pictures and tables ------------------------------------------------------------------------
const models = {};
const model = (name) =>
  (models[name] ??= Bokeh.documents.map((one) => one.get_model_by_name(name)).find(Boolean));
let kept = null; // { seen, fields } of the state that was kept
let shown = null; // what is on the page

function line(name, [x, y] = [[], []]) {
  const source = model(name);
  if (x.length || source.data.x.length) source.data = { x, y }; // an empty one is drawn anew too
}

function rise(picture, most) {
  // The axis begins at 0 and is long enough, and not much longer.
  const range = model(picture).y_range;
  if (most <= range.end && most >= 0.4 * range.end) return;
  const decade = 10 ** Math.floor(Math.log10(Math.max(most, 1e-3)));
  range.end = [1.2, 2, 3, 5, 7, 10, 12].map((k) => k * decade).find((end) => end >= 1.05 * most);
}

function curves(seen) {
  const found = { partition: [], recovery: [], bed: [], gradation: [], time: seen.time ?? [] };
  const sizes = SCREEN.edges.map((edge) => edge * 1e3);
  for (const deck of seen.decks) {
    found.partition.push(deck.partition);
    found.recovery.push(deck.passed.length ? [deck.places, deck.passed] : undefined);
    found.bed.push([deck.places, deck.bed.map((parts) => 1e3 * sum(parts.map((part) => part[0])))]);
  }
  for (const { passing } of seen.products) found.gradation.push([sizes, passing.map((x) => 100 * x)]);
  return found;
}

// Pictures on the part of the page that people see follow every move, the others once it rests.
const there = new Set(), inView = new Set();
const watcher = new IntersectionObserver((entries) => {
  for (const { target, isIntersecting } of entries)
    inView[isIntersecting ? "add" : "delete"](target.id.replace("picture-", ""));
}, { rootMargin: "100px" });
let rest = 0;

function draw(seen, everything = false) {
  shown = seen;
  clearTimeout(rest);
  if (!everything) rest = setTimeout(() => draw(shown, true), 300);
  const now = curves(seen), before = kept ? curves(kept.seen) : {};
  const most = (...parts) => Math.max(...parts.flat().flatMap((one) => one[1]));
  for (const [picture, names] of Object.entries(SCREEN.lines)) {
    if (!there.has(picture) || !(everything || inView.has(picture))) continue;
    names.forEach((name, k) => {
      line(`${picture}: ${name}`, now[picture][k]);
      if (picture !== "time") line(`${picture}: ${name}, kept`, before[picture]?.[k]);
    });
    if (picture === "bed") rise("bed", most(now.bed, before.bed ?? []));
    if (picture === "map") drawMap(seen);
    if (picture === "time" && seen.time) {
      const [[times]] = seen.time;
      rise("time", most(seen.time));
      model("time").x_range.setv({ start: times[0], end: Math.max(clock, times[0] + 10) });
    }
  }
  if (!everything) drawTables(seen);
}

function drawMap(seen) {
  const { bed } = seen.decks[Number(byId("map-deck").value)];
  const most = Math.max(...bed.map((parts) => sum(parts.map((part) => part[0]))));
  rise("map", 1e3 * most);
  const image = model("map: bed").data.image[0], high = model("map").y_range.end / 1e3;
  const rows = image.length / POINTS;
  image.fill(NaN); // nothing there: Bokeh paints it as nothing
  bed.forEach((parts, k) => {
    let top = 0, row = 0;
    for (const [depth, share] of parts) {
      top += depth;
      for (; row < rows && (row + 0.5) * high < top * rows; row++) image[row * POINTS + k] = share;
    }
  });
  model("map: bed").data.dh[0] = 1e3 * high;
  model("map: bed").change.emit();
}

const number = (x) => (Number.isFinite(x) ? String(Number(x.toPrecision(4))) : "\u2013");

function fill(table, rows) {
  // Text into the cells of a table, which are made anew only where their number changes.
  const [head, body] = [table.tHead, table.tBodies[0]];
  const shape = rows.map((row) => row.length).join();
  if (table.dataset.shape !== shape) {
    table.dataset.shape = shape;
    for (const part of [head, body]) part.replaceChildren();
    rows.forEach((row, r) => {
      const made = (r ? body : head).insertRow();
      row.forEach((_, k) => made.append(document.createElement(r && k ? "td" : "th")));
    });
  }
  rows.forEach((row, r) => row.forEach((cell, k) => {
    const place = table.rows[r].cells[k], { text, title = "", kept: old = false } = cell.text === undefined ? { text: cell } : cell;
    if (place.textContent !== text) place.textContent = text;
    if (place.title !== title) place.title = title;
    place.classList.toggle("kept", old);
  }));
}

function drawTables(seen) {
  const states = kept ? [seen, kept.seen] : [seen];
  const each = (make) => states.flatMap((one, k) => make(one).map((text) => ({ text, kept: k > 0 })));
  const heads = (make) => states.flatMap((one, k) =>
    make(one).map((text) => ({ text: k ? `${text} kept` : text, kept: k > 0 })));
  const fed = (one) => one.products[0].rate;
  fill(byId("products"), [
    ["", ...heads(() => ["t/h", "% of feed", "P80, mm", "P50, mm"])],
    ...SCREEN.lines.gradation.map((name, k) => [name, ...each((one) => {
      const { rate, p80, p50 } = one.products[k];
      return [rate / UNIT.rate, (100 * rate) / fed(one), p80 * 1e3, p50 * 1e3].map(number);
    })]),
  ]);
  byId("headline").textContent = seen.decks.map(({ figures }, d) =>
    `deck ${d + 1}, ${number(figures.aperture * 1e3)} mm: efficiency ${number(100 * figures.efficiency)} %, `
    + `cut size ${number(figures.cut_size * 1e3)} mm`).join("; ");
  const label = ({ label: text, unit, tells: title }) => ({ text: unit ? `${text}, ${unit}` : text, title });
  fill(byId("figures"), [
    ["", ...heads((one) => one.decks.map((_, d) => `deck ${d + 1}`))],
    ...SCREEN.rows.map((row) => [label(row), ...each((one) =>
      one.decks.map((deck) => number(deck.figures[row.scalar] / row.factor)))]),
  ]);
  fill(byId("box"), [
    ["", ...heads(() => ["box"])],
    ...SCREEN.box.map((row) => [label(row), ...each((one) => [number(one.output[row.scalar] / row.factor)])]),
  ]);
  const list = byId("alarms"), texts = seen.alarms;
  if (list.dataset.said !== texts.join("\n")) {
    list.dataset.said = texts.join("\n");
    list.replaceChildren(...texts.map((text) => Object.assign(document.createElement("li"), { textContent: text })));
  }
}

// --- what people do -----------------------------------------------------------------------------
const fieldOf = (k) => byId(`field${k}`);
const sliderOf = (k) => byId(`slider${k}`);
const wrong = new Map(); // fields that hold no number, with what is said of them
let passing; // at every limit of the classes, as typed
let initial; // the fields as the page came
let edited = new Map(); // numbers that were changed, in the unit of their keys, by control

function renew(anew = false) {
  // After a change: solve or restart, draw, or say what is wrong.
  const faults = [...wrong.values()];
  let fault = null;
  try {
    if (mode() === "steady") draw(solve());
    else if (anew || !accepted) {
      begin();
      draw(watch());
    }
  } catch (error) {
    if (error instanceof Error) throw error;
    fault = error;
    faults.push(error.text);
  }
  say(faults, fault);
}

function say(faults, fault) {
  byId("said").hidden = !faults.length;
  byId("said").textContent = faults.join("\n");
  CONTROLS.forEach(({ place }, k) => {
    const bad = wrong.has(k) || fault?.index === place;
    fieldOf(k).setAttribute("aria-invalid", bad);
    if (bad) fieldOf(k).closest("details").open = true;
  });
}

function setNumber(k, text) {
  // A number as it was typed or slid; what is no number is told and leaves the old one.
  const { place } = CONTROLS[k], { name, factor, range, cure } = SCREEN.settings[place];
  const value = text.trim() === "" ? NaN : Number(text.trim().replace(",", "."));
  if (Number.isNaN(value)) {
    wrong.set(k, `${name} = '${text}' is not a number${range}: ${cure}`);
  } else {
    wrong.delete(k);
    edited.set(k, value);
    wanted[place] = factor === 1 ? value : value * factor;
    sliderOf(k).value = value;
  }
  renew(!CONTROLS[k].live);
}

function setPassing(k, text) {
  // Per cent that pass a limit of the classes, between those of its neighbours.
  const now = finerBy(Number(byId("finer").value)), value = Number(text.trim().replace(",", ".")) / 100;
  const [low, high] = [now[k - 1], now[k + 1]], at = general(SCREEN.edges[k] * 1e3, 6);
  if (!(text.trim() !== "" && value >= low && value <= high)) {
    const [least, most] = [low, high].map((x) => general(100 * x, 4));
    wrong.set(`passing${k}`, `passing at ${at} mm = ${text} % does not lie between those at the sizes `
      + `beside it (${least} to ${most} %): passing never falls with size`);
  } else {
    wrong.delete(`passing${k}`);
    passing = now.with(k, value);
    byId("finer").value = 0;
    setFeed(passing);
  }
  byId(`passing${k}`).setAttribute("aria-invalid", wrong.has(`passing${k}`));
  renew();
}

const finerBy = (power) => (power === 0 ? passing : passing.map((x) => x ** 2 ** -power));

function setFeed(curve) {
  // Mass fractions of a cumulative curve, over their sum as Python has them.
  const shares = curve.slice(1).map((x, k) => x - curve[k]), whole = sum(shares);
  const start = steady.about.at.fraction - steady.about.settings[0];
  wanted.set(shares.map((x) => (Math.abs(whole - 1) > 1e-14 ? x / whole : x)), start);
}

function showPassing(except) {
  finerBy(Number(byId("finer").value)).forEach((x, k) => {
    if (byId(`passing${k}`) && k !== except) byId(`passing${k}`).value = general(100 * x, 4);
  });
}

function fields() {
  return { wanted: wanted.slice(), edited: new Map(edited), passing, finer: byId("finer").value,
    texts: CONTROLS.map((_, k) => fieldOf(k).value) };
}

function putBack(state) {
  wrong.clear();
  wanted.set(state.wanted);
  [edited, passing] = [new Map(state.edited), state.passing];
  byId("finer").value = state.finer;
  state.texts.forEach((text, k) => {
    fieldOf(k).value = sliderOf(k).value = text;
    sliderOf(k).value = text;
  });
  all("[data-passing]").forEach((field) => field.setAttribute("aria-invalid", false));
  showPassing();
  renew(true);
}

function toml() {
  // The file of the screen with the numbers of the fields: what Python writes, by the same rules.
  const tree = structuredClone(SCREEN.tree);
  for (const [k, value] of edited) {
    const path = [...CONTROLS[k].where], last = path.pop();
    path.reduce((part, key) => part[key], tree)[last] = value;
  }
  const start = steady.about.at.fraction - steady.about.settings[0];
  tree.feed.mass_fraction = [...wanted.subarray(start, start + CLASSES)];
  const isTable = (value) => typeof value === "object" && (!Array.isArray(value) || typeof value[0] === "object" && !Array.isArray(value[0]));
  const text = (value) => Array.isArray(value) ? `[${value.map(text).join(", ")}]`
    : JSON.stringify(value).replace(/\x7f/g, "\\u007f");
  const lines = (table, name) => [
    ...Object.entries(table).filter(([, value]) => !isTable(value)).map(([key, value]) => `${key} = ${text(value)}`),
    ...Object.entries(table).filter(([, value]) => isTable(value)).flatMap(([key, value]) => {
      const full = name ? `${name}.${key}` : key;
      return Array.isArray(value) ? value.flatMap((one) => ["", `[[${full}]]`, ...lines(one, full)])
        : ["", `[${full}]`, ...lines(value, full)];
    }),
  ];
  return `${lines(tree, "").join("\n").trimStart()}\n`;
}

const mode = () => document.querySelector("[name=mode]:checked").value;
let playing = false, last = 0;

function play(on) {
  playing = on;
  byId("play").textContent = on ? "Pause" : "Go on";
  if (on) requestAnimationFrame((now) => { last = now; tick(now); });
}

function tick(now) {
  // A step of the engine and a picture, up to twelve times a second.
  if (!playing) return;
  requestAnimationFrame(tick);
  const passed = Math.min(now - last, 500);
  if (passed < 80) return;
  last = now;
  let fault = null;
  try {
    advance((passed / 1000) * Number(byId("speed").value));
  } catch (error) {
    if (error instanceof Error) throw error;
    fault = error;
  }
  say([...wrong.values(), ...(fault ? [fault.text] : [])], fault);
  draw(watch());
  byId("now").textContent = `${general(clock, clock < 1000 ? 3 : 5)} s`;
}

function listen() {
  for (const slider of all("input[type=range][data-control]")) {
    slider.addEventListener("input", () => {
      const k = Number(slider.dataset.control);
      fieldOf(k).value = slider.value;
      setNumber(k, slider.value);
    });
  }
  for (const field of all("input[type=text][data-control]"))
    field.addEventListener("change", () => setNumber(Number(field.dataset.control), field.value));
  for (const field of all("[data-passing]"))
    field.addEventListener("change", () => setPassing(Number(field.dataset.passing), field.value));
  byId("finer").addEventListener("input", () => {
    setFeed(finerBy(Number(byId("finer").value)));
    showPassing();
    renew();
  });
  for (const choice of [byId("map-deck"), byId("map-size")])
    choice.addEventListener("change", () => (mode() === "steady" ? renew() : draw(watch())));
  for (const radio of all("[name=mode]")) {
    radio.addEventListener("change", () => {
      const runs = mode() === "running";
      byId("clock").hidden = byId("card-time").hidden = !runs;
      byId("card-recovery").hidden = runs;
      renew();
      play(runs && accepted !== null);
    });
  }
  byId("play").addEventListener("click", () => play(!playing));
  byId("restart").addEventListener("click", () => renew(true));
  byId("keep").addEventListener("click", () => {
    kept = { seen: shown, fields: fields() };
    byId("back").disabled = byId("forget").disabled = false;
    draw(shown);
  });
  byId("back").addEventListener("click", () => putBack(kept.fields));
  byId("forget").addEventListener("click", () => {
    kept = null;
    byId("back").disabled = byId("forget").disabled = true;
    draw(shown);
  });
  byId("reset").addEventListener("click", () => putBack(initial));
  byId("toml").addEventListener("click", () => {
    byId("text").value = toml();
    byId("save").href = URL.createObjectURL(new Blob([toml()], { type: "application/toml" }));
    byId("file").showModal();
    byId("text").setSelectionRange(0, 0);
  });
  byId("copy").addEventListener("click", async () => {
    byId("text").select();
    await navigator.clipboard?.writeText(byId("text").value).catch(() => document.execCommand("copy"));
  });
}

async function put([name, picture]) {
  await Bokeh.embed.embed_item(picture, `picture-${name}`);
  there.add(name);
  inView.add(name);
  watcher.observe(byId(`picture-${name}`));
}

async function start() {
  const [first, ...others] = Object.entries(JSON.parse(byId("drawn").textContent));
  await Promise.all([load(), put(first)]);
  passing = sums(SCREEN.fractions);
  passing[CLASSES] = 1;
  showPassing();
  initial = fields();
  listen();
  renew();
  requestAnimationFrame(() => setTimeout(() => performance.mark("first picture")));
  for (const one of others) {
    await new Promise((done) => setTimeout(done, 20)); // the browser paints what is there
    await put(one);
  }
  if (shown) draw(shown, true);
}

const ready = start().catch((error) => {
  byId("said").hidden = false;
  byId("said").textContent = `This page needs a browser of 2023 or later: ${error}`;
  throw error;
});
