// Reads what a bake left: the manifest, the level, and per page its light as textures.

import * as THREE from 'three';
import { EXRLoader } from 'three/examples/jsm/loaders/EXRLoader.js';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';

import { readKtx2 } from './ktx2.js';

export const EXTENSION = 'LUMEL_light_vector_map';

/** Where the bytes come from: what `lumel view` put into the page, or the server that it is. */
export function source() {
  const bake = JSON.parse(document.getElementById('bake').textContent);
  if (!bake) {
    throw new Error('This is the viewer alone. Use: lumel view DIR');
  }
  const read = async (name) => {
    if (bake.files) {
      const text = bake.files[name];
      if (text === undefined) throw new Error(`${name} is not part of this page`);
      const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
      return bytes.buffer;
    }
    const answer = await fetch(`files/${encodeURIComponent(name)}`);
    if (!answer.ok) throw new Error(`${name}: ${answer.status} ${answer.statusText}`);
    return answer.arrayBuffer();
  };
  return { manifest: bake.manifest, read };
}

/** The level and its pages. */
export async function load({ manifest: name, read }) {
  const manifest = JSON.parse(new TextDecoder().decode(await read(name)));
  const glb = manifest.files.find((file) => file === `${name.slice(0, -'.lumel.json'.length)}.glb`);
  if (!glb) throw new Error('The bake has no level: bake with glb among --outputs.');
  const gltf = await new Promise(async (resolve, reject) =>
    new GLTFLoader().parse(await read(glb), '', resolve, reject),
  );
  const maps = gltf.parser.json.extensions?.[EXTENSION]?.maps ?? [];
  const pages = await Promise.all(maps.map((map, index) => loadPage(map, manifest.pages[index], read)));
  return { manifest, gltf, pages };
}

/** What views show of a page: `light` is three layers of (G, φ), `irradiance`, `error`; absent ones are null. */
async function loadPage(map, said, read) {
  const file = (uri) => decodeURIComponent(uri);
  const isHalf = (uri) => said.maps.find((entry) => entry.file === file(uri))?.precision === 'half';
  const picture = async (uri, half) => readExr(await read(file(uri)), half);

  let light = null;
  let hasFluence = false;
  if (map.ktx2) {
    light = readKtx2(await read(file(map.ktx2)));
    hasFluence = true;
  } else if (map.lightVector) {
    const { r, g, b } = map.lightVector;
    const uris = [r, g, b, ...(map.fluence ? [map.fluence] : [])];
    const half = uris.every(isHalf);
    light = layers(await Promise.all(uris.map((uri) => picture(uri, half))), half);
    hasFluence = Boolean(map.fluence);
  }
  const plain = async (uri) => (uri ? texture(await picture(uri, isHalf(uri)), isHalf(uri)) : null);
  return {
    size: new THREE.Vector2(map.width, map.height),
    light,
    hasFluence,
    irradiance: await plain(map.irradiance),
    error: await plain(map.error),
    gradient: map.lightVectorDu ? () => slopes(map, picture) : null,
    brightest: said.maps.find((entry) => entry.plane === 'E')?.max ?? 1,
  };
}

/** Four numbers per pixel, from the top row down. */
function readExr(bytes, half) {
  const loader = new EXRLoader();
  loader.setDataType(half ? THREE.HalfFloatType : THREE.FloatType);
  const { width, height, data } = loader.parse(bytes);
  const stored = data.length / (width * height);
  const pixels = new data.constructor(4 * width * height);
  for (let y = 0; y < height; y++) {
    // The loader turns pictures upside down.
    const row = (height - 1 - y) * width;
    for (let x = 0; x < width; x++) {
      for (let k = 0; k < 4; k++) {
        pixels[4 * (y * width + x) + k] = data[stored * (row + x) + Math.min(k, stored - 1)];
      }
    }
  }
  return { width, height, pixels };
}

/** The three layers of a .ktx2, from the maps of G and φ. */
function layers([r, g, b, phi], half) {
  const { width, height } = r;
  const n = width * height;
  const pixels = new r.pixels.constructor(4 * n * 3);
  [r, g, b].forEach((picture, layer) => {
    for (let i = 0; i < n; i++) {
      for (let k = 0; k < 3; k++) pixels[4 * (layer * n + i) + k] = picture.pixels[4 * i + k];
      pixels[4 * (layer * n + i) + 3] = phi ? phi.pixels[4 * i + layer] : 0;
    }
  });
  return finish(new THREE.DataArrayTexture(pixels, width, height, 3), half ? THREE.HalfFloatType : THREE.FloatType);
}

function texture({ width, height, pixels }, half) {
  return finish(new THREE.DataTexture(pixels, width, height), half ? THREE.HalfFloatType : THREE.FloatType);
}

/** Rows stay as they are: v = 0 is the first one, as in glTF. */
export function finish(made, type) {
  made.format = THREE.RGBAFormat;
  made.type = type;
  made.minFilter = THREE.LinearFilter;
  made.magFilter = THREE.LinearFilter;
  made.generateMipmaps = false;
  made.flipY = false;
  made.needsUpdate = true;
  return made;
}

/** |∂G| per texel step, of all channels together. */
async function slopes(map, picture) {
  const uris = [map.lightVectorDu, map.lightVectorDv].flatMap(({ r, g, b }) => [r, g, b]);
  const pictures = await Promise.all(uris.map((uri) => picture(uri, false)));
  const { width, height } = pictures[0];
  const pixels = new Float32Array(4 * width * height);
  for (let i = 0; i < width * height; i++) {
    let sum = 0;
    for (const each of pictures) {
      for (let k = 0; k < 3; k++) sum += each.pixels[4 * i + k] ** 2;
    }
    pixels[4 * i] = Math.sqrt(sum);
  }
  return texture({ width, height, pixels }, false);
}

/** About the largest irradiance: 99 % of the lit texels have less. */
export function brightness(pages) {
  const found = [];
  for (const { irradiance } of pages) {
    if (!irradiance) continue;
    const { data } = irradiance.image;
    const number = irradiance.type === THREE.HalfFloatType ? THREE.DataUtils.fromHalfFloat : (x) => x;
    const step = Math.max(1, Math.floor(data.length / 4 / 20000));
    for (let i = 0; i < data.length / 4; i += step) {
      const e = [0, 1, 2].map((k) => number(data[4 * i + k]));
      const luminance = 0.2126 * e[0] + 0.7152 * e[1] + 0.0722 * e[2];
      if (luminance > 0) found.push(luminance);
    }
  }
  found.sort((a, b) => a - b);
  return found[Math.floor(0.99 * found.length)] ?? 1;
}
