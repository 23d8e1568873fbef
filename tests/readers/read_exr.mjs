// Reads OpenEXR files with three's EXRLoader and dumps their samples.
//
// Usage: node read_exr.mjs NODE_MODULES ((half|float) N_CHANNELS FILE)...
// For each file writes FILE.three.raw: all channels (R, G, B or Y), one after
// the other, rows from the top down (three decodes them bottom up), in the type
// asked for; three spreads Y and RGB over four channels. Prints one JSON object per file.

import { readFileSync, writeFileSync } from 'node:fs';
import { join } from 'node:path';
import { pathToFileURL } from 'node:url';

const [modules, ...files] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(join(modules, path)));
const THREE = await load('three/build/three.module.js');
const { EXRLoader } = await load('three/examples/jsm/loaders/EXRLoader.js');

for (let at = 0; at < files.length; at += 3) {
  const [type, count, path] = files.slice(at, at + 3);
  const bytes = readFileSync(path);
  const loader = new EXRLoader();
  loader.setDataType(type === 'half' ? THREE.HalfFloatType : THREE.FloatType);
  const picture = loader.parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length));

  const { width, height, data } = picture;
  const stored = data.length / (width * height);
  const channels = Number(count);
  const planes = new data.constructor(channels * width * height);
  for (let channel = 0; channel < channels; channel++) {
    for (let y = 0; y < height; y++) {
      for (let x = 0; x < width; x++) {
        const from = ((height - 1 - y) * width + x) * stored + channel;
        planes[(channel * height + y) * width + x] = data[from];
      }
    }
  }
  writeFileSync(`${path}.three.raw`, new Uint8Array(planes.buffer));
  console.log(JSON.stringify({ width, height, stored }));
}
