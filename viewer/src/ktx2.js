// Reads the textures that lumel writes. three's own loader shows the first layer only, and brings a transcoder that nothing here needs.

import * as THREE from 'three';

import { finish } from './bake.js';

/** Numbers of VkFormat, with the type of their components. */
const FORMATS = {
  97: [THREE.HalfFloatType, Uint16Array],
  109: [THREE.FloatType, Float32Array],
};

export function readKtx2(bytes) {
  const view = new DataView(bytes);
  const word = (index) => view.getUint32(12 + 4 * index, true);
  const [format, , width, height, , layers, , , supercompression] = [0, 1, 2, 3, 4, 5, 6, 7, 8].map(word);
  const known = FORMATS[format];
  if (view.getUint32(0, true) !== 0x58544bab || !known || supercompression !== 0) {
    throw new Error('The .ktx2 is not one of lumel.');
  }
  const start = Number(view.getBigUint64(80, true));
  const [type, Numbers] = known;
  const pixels = new Numbers(bytes, start, 4 * width * height * layers);
  return finish(new THREE.DataArrayTexture(pixels, width, height, layers), type);
}
