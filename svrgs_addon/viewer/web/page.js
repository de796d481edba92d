// The page of `svrgs view --export`: Spark and three.js draw one splat, or the pruned one with a wipe against the original.
// World coordinates are those of the files that 3DGS writes.

const page = JSON.parse(document.getElementById("page").textContent);
const part = (id) => document.getElementById(id);

function say(lines) {
  part("texts").replaceChildren(...lines.map((line) => Object.assign(document.createElement("p"), { textContent: line })));
}

async function unpacked(name) {
  const answer = await fetch(`modules/${name}.bin`);
  if (!answer.ok) throw new Error(`modules/${name}.bin: ${answer.status} ${answer.statusText}`);
  return new Response(answer.body.pipeThrough(new DecompressionStream("gzip"))).text();
}

// Unpacks and imports modules, each of which may import those before it. Returns them in this order.
async function imported(names) {
  const texts = await Promise.all(names.map(unpacked));
  const addresses = {};
  names.forEach((name, k) => {
    let text = texts[k];
    for (const [other, address] of Object.entries(addresses)) text = text.replaceAll(`"./${other}"`, `"${address}"`);
    addresses[name] = URL.createObjectURL(new Blob([text], { type: "text/javascript" }));
  });
  return Promise.all(names.map((name) => import(addresses[name])));
}

const started = performance.now();
const [, core, gl, spark] = await imported(page.modules).catch((error) => {
  say([`This page cannot start: ${error.message}`]);
  throw error;
});
// the names that these minified modules export
const { Qi: Scene, Or: PerspectiveCamera, eo: Vector3, U: Color } = core;
const vector = (values) => new Vector3(...values);

const renderer = (() => { // gl.o is WebGLRenderer
  try {
    return new gl.o({ canvas: part("canvas"), antialias: false });
  } catch (error) {
    say(["This browser has no WebGL 2."]);
    throw error;
  }
})();
renderer.setClearColor(new Color().setRGB(...page.background, "srgb"));
const camera = new PerspectiveCamera(50, 1, page.near, 1e6 * page.near);
const view = { position: vector(page.start.position), target: vector(page.start.target), up: vector(page.start.up), fov: page.start.fov };
const up = vector(page.up);
const shown = []; // by the number of their scene
window.svrgs = { look, draws: 0, seconds: 0 }; // for scripts: pictures drawn, and seconds until the scene was loaded

// Loads a scene and shows it.
async function load(k) {
  const scene = page.scenes[k], stage = new Scene();
  const alphaCut = 1 / 255;
  stage.add(new spark.SparkRenderer({
    renderer, onDirty: redraw, enableLod: false, accumExtSplats: true, sortRadial: false, minAlpha: alphaCut, maxStdDev: Math.sqrt(-2 * Math.log(alphaCut)),
    maxPixelRadius: 1e5, preBlurAmount: scene.antialiased ? 0 : page.blur, blurAmount: scene.antialiased ? page.blur : 0,
  }));
  const percent = (event) => event.lengthComputable && say([...texts(), `${Math.round(100 * event.loaded / event.total)} % loaded`]);
  const splats = new spark.SplatMesh({ url: scene.file, extSplats: true, onProgress: percent });
  splats.quaternion.set(1, 0, 0, 0); // an SPZ is right, up, back
  stage.add(splats);
  await splats.initialized;
  shown[k] = stage;
  say(texts());
  redraw();
}

function texts() {
  return [...page.scenes.map((scene) => scene.text), ...page.notes];
}

let waiting = false;
function redraw() {
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(draw);
}

function draw() {
  waiting = false;
  const width = innerWidth, height = innerHeight, last = page.scenes.length - 1;
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setSize(width, height, false);
  camera.fov = view.fov, camera.aspect = width / height;
  camera.position.copy(view.position), camera.up.copy(view.up), camera.lookAt(view.target);
  camera.updateProjectionMatrix(), camera.updateMatrixWorld();
  const edge = Math.round(width * part("wipe").value);
  part("edge").style.left = `${edge}px`;
  renderer.setScissorTest(true);
  if (last && shown[0]) renderer.setScissor(0, 0, edge, height), renderer.render(shown[0], camera);
  const left = last && shown[0] ? edge : 0;
  if (shown[last]) renderer.setScissor(left, 0, width - left, height), renderer.render(shown[last], camera);
  window.svrgs.draws += 1;
}

function right() {
  return new Vector3().subVectors(view.target, view.position).cross(view.up).normalize();
}

// About what is up in the world, and then about what is right; a camera that was tilted stays so. x, y: radians.
function turn(x, y) {
  const offset = new Vector3().subVectors(view.position, view.target), tilt = offset.angleTo(up);
  const least = Math.min(tilt, 0.05), wanted = Math.min(Math.max(tilt, Math.PI - 0.05), Math.max(least, tilt - y));
  for (const [axis, angle] of [[up, -x], [right().applyAxisAngle(up, -x), tilt - wanted]])
    offset.applyAxisAngle(axis, angle), view.up.applyAxisAngle(axis, angle);
  view.position.copy(view.target).add(offset);
}

// x, y: in heights of the picture.
function pan(x, y) {
  const size = 2 * Math.tan(view.fov * Math.PI / 360) * view.position.distanceTo(view.target), across = right();
  const down = new Vector3().subVectors(view.target, view.position).normalize().cross(across);
  const step = across.multiplyScalar(-x * size).addScaledVector(down, -y * size);
  view.position.add(step), view.target.add(step);
}

function zoom(factor) {
  view.position.sub(view.target).multiplyScalar(factor).add(view.target);
}

function look(one) {
  view.position = vector(one.position), view.target = vector(one.target), view.up = vector(one.up), view.fov = one.fov;
  redraw();
}

// One pointer turns; with the right button, Shift, or two pointers it pans, and two zoom.
const pointers = new Map();
const canvas = part("canvas");
canvas.addEventListener("pointerdown", (event) => {
  canvas.setPointerCapture(event.pointerId);
  pointers.set(event.pointerId, [event.clientX, event.clientY]);
});
canvas.addEventListener("pointermove", (event) => {
  const before = pointers.get(event.pointerId);
  if (!before) return;
  const now = [event.clientX, event.clientY], x = (now[0] - before[0]) / innerHeight, y = (now[1] - before[1]) / innerHeight;
  if (pointers.size === 2) {
    const [other] = [...pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const apart = (at) => Math.max(1, Math.hypot(at[0] - other[0], at[1] - other[1]));
    zoom(apart(before) / apart(now)), pan(x / 2, y / 2);
  } else if (event.buttons & 2 || event.shiftKey) pan(x, y);
  else turn(x * Math.PI, y * Math.PI);
  pointers.set(event.pointerId, now);
  redraw();
});
for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => pointers.delete(event.pointerId));
canvas.addEventListener("contextmenu", (event) => event.preventDefault());
canvas.addEventListener("wheel", (event) => {
  event.preventDefault();
  zoom(Math.exp(event.deltaY / 1000));
  redraw();
}, { passive: false });
addEventListener("resize", redraw);

const choice = part("cameras");
page.cameras.forEach((one) => choice.add(new Option(one.name)));
choice.hidden = page.cameras.length < 2;
choice.addEventListener("change", () => look(page.cameras[choice.selectedIndex]));
part("wipe").addEventListener("input", redraw);
const compare = part("compare");
compare.hidden = page.scenes.length < 2, compare.textContent = page.compare;
compare.addEventListener("click", async () => {
  compare.disabled = true;
  await load(0).catch((error) => say([`${page.scenes[0].file} cannot be shown: ${error.message ?? error}`]));
  compare.hidden = true, part("wipe").hidden = part("edge").hidden = !shown[0];
  redraw();
});

const last = page.scenes.length - 1;
await load(last).catch((error) => say([`${page.scenes[last].file} cannot be shown: ${error.message ?? error}`]));
window.svrgs.seconds = (performance.now() - started) / 1000;
