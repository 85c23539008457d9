// The page: what the reader does with mouse, fingers and keys, and when a frame is drawn.

const FIELD_OF_VIEW = 35 * Math.PI / 180;   // vertical: that of the desktop program
const MOST_PIXELS = 4e6;                    // of a frame: a few hundred megabytes of sums
const SLOW = 45, QUICK = 22;                // milliseconds a frame: coarser above, finer below, while something moves
const COARSEST = 0.4;
const AT_REST = 160;                        // milliseconds without a change until a frame is drawn in full

const page = JSON.parse(document.getElementById("page").textContent);
const element = (name) => document.getElementById(name);
const canvas = element("canvas"), dark = matchMedia("(prefers-color-scheme: dark)");
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

const start = () => ({ ...page.view, target: [...page.view.target] });
let view = start();
let cuts = page.planes.map(anglesOf);       // each as distance, tilt and turn: as the desktop program says it
let current = 0, cutting = true, renderer = null;

// A number with these digits after the point, and no minus before zero.
function rounded(value, digits) {
    const scale = 10 ** digits;
    return (Math.round(value * scale) / scale + 0).toFixed(digits);
}

// A plane in words: its distance from the middle of the object along the normal, and two angles of the normal in degrees.
function anglesOf(plane) {
    const along = dot(page.axes.up, plane), x = dot(page.axes.first, plane), y = dot(page.axes.second, plane);
    const flat = Math.hypot(x, y), degrees = (a, b) => Math.atan2(a, b) * 180 / Math.PI;
    return { distance: -(dot(page.middle, plane) + plane[3]), tilt: degrees(flat, along), turn: flat > 1e-9 ? degrees(y, x) : 0 };
}

function normalOf({ tilt, turn }) {
    const a = tilt * Math.PI / 180, b = turn * Math.PI / 180;
    const level = add(times(page.axes.first, Math.cos(b)), times(page.axes.second, Math.sin(b)));
    return add(times(page.axes.up, Math.cos(a)), times(level, Math.sin(a)));
}

function planeOf(cut) {
    const normal = normalOf(cut);
    return [...normal, -(dot(page.middle, normal) + cut.distance)];
}

// How far from the middle a plane with this normal still meets the object's box.
function reachOf(cut) {
    return page.half.reduce((sum, half, i) => sum + half * Math.abs(normalOf(cut)[i]), 0);
}

// Frames

let scale = 1, moving = false, flowing = false, waiting = 0, asked = false, before = 0;

function changed() {
    moving = true;
    canvas.dataset.drawn = "moving";
    clearTimeout(waiting);
    waiting = setTimeout(() => { moving = false; ask(); }, AT_REST);
    ask();
}

function ask() {
    if (!asked) requestAnimationFrame(frame);
    asked = true;
}

function frame(now) {
    asked = false;
    if (!renderer) return;
    if (moving && flowing) {
        if (now - before > SLOW) scale = Math.max(COARSEST, 0.85 * scale);
        else if (now - before < QUICK) scale = Math.min(1, 1.1 * scale);
    }
    [before, flowing] = [now, moving];
    const box = canvas.getBoundingClientRect(), ratio = Math.min(devicePixelRatio || 1, 2);
    const full = Math.min(ratio, Math.sqrt(MOST_PIXELS / Math.max(box.width * box.height, 1)));
    const [width, height] = [box.width, box.height].map((side) => Math.max(1, Math.round(side * full * (moving ? scale : 1))));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    renderer.resize(width, height);
    renderer.draw(camera(width, height), cutting ? cuts.map(planeOf) : [], background());
    if (!moving) canvas.dataset.drawn = "rest";
}

function camera(width, height) {
    const distance = view.distance * fitDistance(view.radius, FIELD_OF_VIEW, width / height);
    return orbit(page.axes, view.target, view.azimuth, view.elevation, distance, FIELD_OF_VIEW, width, height);
}

function background() {
    const text = getComputedStyle(canvas).backgroundColor;
    return text.match(/[\d.]+/g).slice(0, 3).map((value) => value / 255);
}

// What the reader does

function turn(across, down) {
    view.azimuth -= 0.35 * across;
    view.elevation = clamp(view.elevation + 0.35 * down, -89.9, 89.9);
    changed();
}

function zoom(factor) {
    view.distance = clamp(view.distance * factor, 0.08, 6);
    changed();
}

function shift(across, down) {
    const box = canvas.getBoundingClientRect(), seen = camera(box.width, box.height), step = seen.distance / seen.focal;
    view.target = add(view.target, add(times(seen.rows[0], -across * step), times(seen.rows[1], -down * step)));
    changed();
}

function slide(across, down) { // the plane follows the pointer, as far as its normal shows in the picture
    const box = canvas.getBoundingClientRect(), seen = camera(box.width, box.height), zoomed = seen.focal / seen.distance;
    const [x, y] = inCamera(seen, [...normalOf(cuts[current]), 0]).map((value) => value * zoomed);
    const length = Math.hypot(x, y);
    const moved = length > 0.25 * zoomed ? (across * x + down * y) / length ** 2 : -down / zoomed;
    set({ distance: cuts[current].distance + moved });
}

function set(values) {
    const cut = { ...cuts[current], ...values }, reach = reachOf(cut);
    cuts[current] = { ...cut, distance: clamp(cut.distance, -reach, reach) };
    cutting = true;
    show();
}

function flip() {
    const { distance, tilt, turn: about } = cuts[current];
    set({ distance: -distance, tilt: 180 - tilt, turn: about > 0 ? about - 180 : about + 180 });
}

function reset() {
    view = start();
    cuts = page.planes.map(anglesOf);
    cutting = true;
    show();
}

// The panel shows what is cut.
function show() {
    const cut = cuts[current], reach = reachOf(cut), digits = clamp(3 - Math.floor(Math.log10(page.edge)), 0, 6);
    for (const [name, value, low, high, text] of [
        ["distance", cut.distance, -reach, reach, rounded(cut.distance * page.edge, digits)],
        ["tilt", cut.tilt, 0, 180, `${cut.tilt.toFixed(0)}°`], ["turn", cut.turn, -180, 180, `${cut.turn.toFixed(0)}°`],
    ]) {
        const slider = element(name);
        Object.assign(slider, { min: low, max: high, step: (high - low) / 1000, value });
        slider.setAttribute("aria-valuetext", text);
        element(`${name}-value`).textContent = text.replace("-", "\u2212");
    }
    element("cutting").checked = cutting;
    document.querySelectorAll("[name=plane]").forEach((chip, k) => { chip.checked = k === current; });
    changed();
}

const KEYS = {
    ArrowRight: () => nudge(1), ArrowUp: () => nudge(1), ArrowLeft: () => nudge(-1), ArrowDown: () => nudge(-1),
    "+": () => zoom(0.9), "=": () => zoom(0.9), "-": () => zoom(1 / 0.9), f: flip, r: reset,
    1: () => set({ tilt: 0, turn: 0 }), 2: () => set({ tilt: 90 }), c: () => { cutting = !cutting; show(); },
};
const TURNS = { ArrowRight: [-20, 0], ArrowLeft: [20, 0], ArrowUp: [0, 20], ArrowDown: [0, -20] };

function nudge(way) {
    set({ distance: cuts[current].distance + way * reachOf(cuts[current]) / 50 });
}

function listen() {
    const pointers = new Map();
    canvas.addEventListener("pointerdown", (event) => {
        canvas.focus({ preventScroll: true });
        canvas.setPointerCapture(event.pointerId);
        pointers.set(event.pointerId, [event.clientX, event.clientY]);
        event.preventDefault();
    });
    for (const name of ["pointerup", "pointercancel"])
        canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => {
        const last = pointers.get(event.pointerId);
        if (!last) return;
        const across = event.clientX - last[0], down = event.clientY - last[1];
        const other = [...pointers].find(([id]) => id !== event.pointerId);
        pointers.set(event.pointerId, [event.clientX, event.clientY]);
        if (other) { // two fingers: each moves the middle between them by half of its way
            const apart = ([x, y]) => Math.max(Math.hypot(x - other[1][0], y - other[1][1]), 1);
            shift(across / 2, down / 2);
            zoom(apart(last) / apart([event.clientX, event.clientY]));
        } else if (event.shiftKey) slide(across, down);
        else if (event.buttons & 6 || event.ctrlKey || event.metaKey) shift(across, down);
        else turn(across, down);
    });
    canvas.addEventListener("wheel", (event) => {
        event.preventDefault();
        zoom(Math.exp(clamp(event.deltaY * (event.deltaMode ? 30 : 1), -120, 120) * (event.ctrlKey ? 0.01 : 0.0015)));
    }, { passive: false });
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => {
        const typing = event.target.matches("input[type=range], input[type=radio]") && event.key.startsWith("Arrow");
        if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
        const turned = event.shiftKey && TURNS[event.key], act = KEYS[event.key] || KEYS[event.key.toLowerCase()];
        if (!turned && !act) return;
        event.preventDefault();
        turned ? turn(...turned) : act();
    });
    for (const name of ["distance", "tilt", "turn"])
        element(name).addEventListener("input", (event) => set({ [name]: event.target.valueAsNumber }));
    element("across").addEventListener("click", KEYS[1]);
    element("along").addEventListener("click", KEYS[2]);
    element("flip").addEventListener("click", flip);
    element("reset").addEventListener("click", reset);
    element("cutting").addEventListener("change", (event) => { cutting = event.target.checked; show(); });
    document.querySelectorAll("[name=plane]").forEach((chip, k) =>
        chip.addEventListener("change", () => { current = k; show(); }));
    new ResizeObserver(changed).observe(canvas);
    dark.addEventListener("change", changed);
    canvas.addEventListener("webglcontextlost", (event) => { event.preventDefault(); renderer = null; });
    canvas.addEventListener("webglcontextrestored", begin);
}

async function begin() {
    const message = element("message");
    try {
        const made = new Renderer(canvas, page);
        await made.load();
        renderer = made;
        message.textContent = "";
        show();
    } catch (error) {
        message.textContent = error.message;
    }
}

listen();
begin();
