// The borders of charts: edges that only one triangle has on the lightmap page.

import * as THREE from 'three';

export function borders(geometry) {
  const { position, uv1 } = geometry.attributes;
  if (!uv1) return null;
  const index = geometry.index?.array ?? [...Array(position.count).keys()];
  // Vertices that differ in their normals only are one.
  const names = new Map();
  const name = new Uint32Array(position.count);
  for (let v = 0; v < position.count; v++) {
    const key = [position.getX(v), position.getY(v), position.getZ(v), uv1.getX(v), uv1.getY(v)].join();
    if (!names.has(key)) names.set(key, v);
    name[v] = names.get(key);
  }
  const edges = new Map();
  for (let i = 0; i + 2 < index.length; i += 3) {
    for (let side = 0; side < 3; side++) {
      const [a, b] = [name[index[i + side]], name[index[i + ((side + 1) % 3)]]].sort((x, y) => x - y);
      const key = a * position.count + b;
      edges.set(key, (edges.get(key) ?? 0) + 1);
    }
  }
  const points = [];
  for (const [key, count] of edges) {
    if (count !== 1) continue;
    for (const v of [Math.floor(key / position.count), key % position.count]) {
      points.push(position.getX(v), position.getY(v), position.getZ(v));
    }
  }
  return new THREE.BufferGeometry().setAttribute('position', new THREE.Float32BufferAttribute(points, 3));
}
