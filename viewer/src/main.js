// The viewer of a bake: loads it, draws it, and lets one look at what it is made of.
//
// Behind the # of the address: view, model, ev, bumps, borders, bare, camera=x,y,z,x,y,z (eye and target), and numbers=WIDTHxHEIGHT, which
// draws E in lux into a float target and writes it into the page as JSON, for tests.

import * as THREE from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';

import { brightness, load, source } from './bake.js';
import { borders } from './borders.js';
import { material, MODELS, shared, VIEWS } from './surface.js';

const FIELD_OF_VIEW = 55;

const options = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
const state = {
  view: options.view ?? 'lit',
  model: options.model ?? 'sky-sun',
  ev: Number(options.ev ?? 0),
  bumps: options.bumps !== '0',
  borders: options.borders === '1',
  bare: options.bare === '1',
};

const started = performance.now();
const renderer = new THREE.WebGLRenderer({ antialias: true, preserveDrawingBuffer: true });
renderer.setPixelRatio(window.devicePixelRatio);
renderer.outputColorSpace = THREE.LinearSRGBColorSpace;
renderer.autoClear = false;
renderer.setClearColor(0x16181c);
document.body.prepend(renderer.domElement);
const camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW);
const controls = new OrbitControls(camera, renderer.domElement);

const message = document.getElementById('message');
const complain = (error) => {
  message.textContent = error.message ?? String(error);
  document.getElementById('result').textContent = JSON.stringify({ error: message.textContent });
};

// A browser without a window lets its clock run ahead while nothing but another thread works on a picture; a timer holds it back.
const beat = options.numbers ? setInterval(() => {}, 1) : 0;
try {
  start(await load(source()));
} catch (error) {
  complain(error);
}
clearInterval(beat);

function start({ manifest, gltf, pages }) {
  const scene = gltf.scene;
  scene.updateMatrixWorld(true);
  const lines = new THREE.Group();
  const surfaces = dress(scene, pages, lines);
  scene.add(lines);
  shared.tolerance.value = manifest.error.tolerance;
  shared.asked.value = manifest.options['texels-per-metre'];
  const natural = 2.3 / brightness(pages);
  aim(scene, gltf.cameras[0]);
  message.remove();

  const draw = () => {
    const has = (what) => pages.some((page) => page[what]);
    const models = state.model === 'all' ? Object.keys(MODELS) : [state.model];
    shared.view.value = Object.keys(VIEWS).indexOf(state.view);
    shared.exposure.value = natural * 2 ** state.ev;
    shared.bumps.value = state.bumps;
    lines.visible = state.borders;
    // A roof that only casts shadows would hide the room from above. Lamps stay.
    for (const mesh of surfaces) mesh.visible = state.bare || mesh.userData.page || mesh.userData.glows;
    if (state.view === 'gradient' && has('gradient')) needGradients(surfaces, draw);
    const { innerWidth: width, innerHeight: height } = window;
    const part = width / models.length;
    camera.aspect = part / height;
    camera.updateProjectionMatrix();
    renderer.setScissorTest(true);
    models.forEach((model, index) => {
      shared.model.value = Object.keys(MODELS).indexOf(model);
      renderer.setViewport(index * part, 0, part, height);
      renderer.setScissor(index * part, 0, part, height);
      renderer.clear();
      renderer.render(scene, camera);
    });
    const names = models.length > 1 ? models.map((model) => `<span>${MODELS[model]}</span>`) : [];
    document.getElementById('names').innerHTML = names.join('');
    explain(manifest, pages);
  };

  if (options.numbers) {
    const [width, height] = options.numbers.split('x').map(Number);
    lines.visible = false;
    document.getElementById('result').textContent = JSON.stringify(numbers(scene, width, height));
    return;
  }
  panel(manifest, pages, draw);
  controls.addEventListener('change', draw);
  const resize = () => {
    renderer.setSize(window.innerWidth, window.innerHeight);
    draw();
  };
  window.addEventListener('resize', resize);
  resize();
  document.getElementById('result').textContent = JSON.stringify({ painted: performance.now() - started });
}

/** Gives every mesh the material of the viewer and its place on a page. Returns the meshes; the borders go to `lines`. */
function dress(scene, pages, lines) {
  const meshes = [];
  scene.traverse((object) => object.isMesh && meshes.push(object));
  const ink = new THREE.LineBasicMaterial({ color: 0xffd23f });
  for (const mesh of meshes) {
    // Of a mesh with several primitives the node is the group above.
    const said = [mesh, mesh.parent].map((o) => o?.userData.lumel?.lightVectorMap).find((found) => found?.map !== undefined || found?.instances);
    const places = said?.instances ?? (said ? [said] : []);
    const chart = ({ scale, offset }) => [...scale, ...offset];
    const instanced = mesh.isInstancedMesh && places.length > 0;
    if (instanced) {
      const charts = new Float32Array(places.flatMap(chart));
      mesh.geometry = mesh.geometry.clone().setAttribute('instanceChart', new THREE.InstancedBufferAttribute(charts, 4));
    }
    const page = places.length ? pages[places[0].map] : null;
    const put = places.length ? new THREE.Vector4(...chart(places[0])) : null;
    const { r, g, b } = mesh.material.emissive ?? {};
    mesh.userData.glows = r + g + b > 0;
    mesh.material = material(mesh.material, mesh.geometry, page, put, instanced);
    mesh.userData.page = page;
    const edges = page && !instanced && borders(mesh.geometry);
    if (edges) {
      const drawn = new THREE.LineSegments(edges, ink);
      drawn.matrixAutoUpdate = false;
      drawn.matrix.copy(mesh.matrixWorld);
      lines.add(drawn);
    }
  }
  return meshes;
}

/** Derivatives are large, and seldom looked at. */
function needGradients(meshes, draw) {
  for (const mesh of meshes) {
    const { page } = mesh.userData;
    const uniform = mesh.material.uniforms.gradientMap;
    if (!page?.gradient || uniform.value) continue;
    page.slopes ??= page.gradient();
    page.slopes.then((made) => {
      if (uniform.value) return;
      uniform.value = made;
      draw();
    }, complain);
  }
}

function aim(scene, authored) {
  const box = new THREE.Box3().setFromObject(scene);
  const size = box.getSize(new THREE.Vector3()).length() || 1;
  const target = box.getCenter(new THREE.Vector3());
  camera.near = size / 2000;
  camera.far = size * 10;
  if (options.camera) {
    const [x, y, z, a, b, c] = options.camera.split(',').map(Number);
    camera.position.set(x, y, z);
    target.set(a, b, c);
  } else if (authored) {
    authored.getWorldPosition(camera.position);
    const forward = authored.getWorldDirection(new THREE.Vector3());
    target.copy(camera.position).addScaledVector(forward, size / 4);
  } else {
    camera.position.copy(target).add(new THREE.Vector3(0.45, 0.4, 0.6).multiplyScalar(size));
  }
  controls.target.copy(target);
  controls.update();
}

/**
 * E in lux at the centre of each pixel, from the top row down; alpha is 1 where there is a surface with light of its own.
 *
 * Drivers move vertices to a sixteenth of a pixel or so. That is made small by drawing each pixel as many, of which the middle one counts.
 */
function numbers(scene, width, height) {
  shared.numbers.value = true;
  // Smaller copies of a normal map depend on the driver.
  scene.traverse(({ material }) => {
    const map = material?.uniforms?.normalMap?.value;
    if (!map) return;
    map.minFilter = THREE.LinearFilter;
    map.generateMipmaps = false;
    map.needsUpdate = true;
  });
  shared.bumps.value = state.bumps;
  shared.model.value = Object.keys(MODELS).indexOf(state.model);
  const parts = 5;
  const [columns, rows] = [parts * width, parts * height];
  const target = new THREE.WebGLRenderTarget(columns, rows, { type: THREE.FloatType });
  camera.aspect = width / height;
  camera.updateProjectionMatrix();
  renderer.setRenderTarget(target);
  renderer.setClearColor(0, 0);
  renderer.clear();
  renderer.render(scene, camera);
  const values = new Float32Array(4 * columns * rows);
  renderer.readRenderTargetPixels(target, 0, 0, columns, rows, values);
  const pixels = [];
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const row = rows - 1 - (parts * y + (parts >> 1));
      const at = 4 * (row * columns + parts * x + (parts >> 1));
      pixels.push(...values.subarray(at, at + 4));
    }
  }
  return { width, height, pixels };
}

/** What the panel says below. */
function explain(manifest, pages) {
  const legend = document.getElementById('legend');
  if (!legend) return;
  const missing = {
    error: !pages.some((page) => page.error) && 'This bake has no error map (--outputs error).',
    gradient: !pages.some((page) => page.gradient) && 'This bake has no derivatives (--outputs gradient).',
    direction: !pages.some((page) => page.light) && 'This bake has no light vectors (--directional).',
    focus: !pages.some((page) => page.hasFluence) && 'This bake has no fluence (--directional).',
  };
  legend.textContent = missing[state.view] || VIEWS[state.view];
}

function panel(manifest, pages, draw) {
  const form = document.getElementById('panel');
  const choice = (names) => names.map(([value, text]) => `<option value="${value}">${text}</option>`).join('');
  const models = [...Object.entries(MODELS), ['all', 'side by side']];
  form.innerHTML = `<h1></h1>
    <label>view <select name="view">${choice(Object.keys(VIEWS).map((view) => [view, view]))}</select></label>
    <label>light <select name="model">${choice(models)}</select></label>
    <label>exposure <input name="ev" type="range" min="-6" max="6" step="0.1" /></label>
    <label>normal maps <input name="bumps" type="checkbox" /></label>
    <label>chart borders <input name="borders" type="checkbox" /></label>
    <label>without texels <input name="bare" type="checkbox" /></label>
    <div id="legend"></div>`;
  form.querySelector('h1').textContent = manifest.scene;
  for (const input of form.elements) {
    const key = input.name;
    if (input.type === 'checkbox') input.checked = state[key];
    else input.value = state[key];
    input.addEventListener('input', () => {
      state[key] = input.type === 'checkbox' ? input.checked : input.type === 'range' ? Number(input.value) : input.value;
      draw();
    });
  }
  form.hidden = false;
}
