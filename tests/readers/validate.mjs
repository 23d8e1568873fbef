// Runs the Khronos glTF validator.
//
// Usage: node validate.mjs NODE_MODULES FILE...
// Prints one JSON object per file: its errors and warnings by code, each with
// how often it occurs and the first place.

import { readFileSync } from 'node:fs';
import { createRequire } from 'node:module';
import { dirname, join, resolve } from 'node:path';
import { pathToFileURL } from 'node:url';

const [modules, ...files] = process.argv.slice(2);
const require = createRequire(pathToFileURL(join(resolve(modules), 'index.js')));
const validator = require('gltf-validator');

for (const path of files) {
  const report = await validator.validateBytes(new Uint8Array(readFileSync(path)), {
    uri: path,
    maxIssues: 0,
    externalResourceFunction: async (uri) =>
      new Uint8Array(readFileSync(join(dirname(path), decodeURIComponent(uri)))),
  });
  const found = [{}, {}];
  for (const { severity, code, message, pointer } of report.issues.messages) {
    const list = found[severity];
    if (list) {
      list[code] ??= { count: 0, first: `${pointer}: ${message}` };
      list[code].count++;
    }
  }
  console.log(JSON.stringify({ errors: found[0], warnings: found[1] }));
}
