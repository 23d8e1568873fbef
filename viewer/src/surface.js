// How a surface is drawn: the light of its page through lumel's own shader snippet, and the views that explain it.

import * as THREE from 'three';

import lumel from '../../src/runtime/lumel.glsl?raw';

/** In the order of their numbers in the shader. */
export const VIEWS = {
  lit: 'What an engine shows: albedo · E / π and emission.',
  irradiance: 'E at the normal that is seen.',
  direction: 'Where the light comes from: the direction of G of the luminance, x, y, z as red, green, blue.',
  focus: '|G| / φ: red is a single small light, green a wide sky, blue lights from opposite sides.',
  error: 'Estimated error of E over the brightest texel: blue none, green the tolerance, red twice that.',
  density: 'Texels, coloured by their number per metre: blue half of what was asked, green that, red twice.',
  gradient: 'Change of G from texel to texel.',
};

export const MODELS = { plain: 'plain lightmap', vector: 'max(0, G·n)', 'sky-sun': 'sky + sun' };

/** Uniforms that all surfaces share. */
export const shared = {
  view: { value: 0 },
  model: { value: 2 },
  exposure: { value: 1 },
  bumps: { value: true },
  numbers: { value: false },
  tolerance: { value: 0.004 },
  asked: { value: 8 },
};

const VERTEX = /* glsl */ `
out vec3 at;
out vec3 base;
out vec2 place;
out vec2 page;
out vec2 bumpPlace;
out vec3 along;
out vec3 across;
out vec4 tint;
uniform vec4 chart;
uniform mat3 albedoPlace;
uniform mat3 normalPlace;
#ifdef HAS_TANGENT
in vec4 tangent;
#endif
#ifdef HAS_PAGE
in vec2 uv1;
#endif
#ifdef INSTANCED_CHART
in vec4 instanceChart;
#endif
#if defined(ALBEDO_SET) && ALBEDO_SET == 2 || defined(NORMAL_SET) && NORMAL_SET == 2
in vec2 uv2;
#endif
void main() {
    mat4 world = modelMatrix;
#ifdef USE_INSTANCING
    world = world * instanceMatrix;
#endif
    vec4 position4 = world * vec4(position, 1.0);
    at = position4.xyz;
    // Normals go with the cofactors, which keep their side below mirrored nodes.
    mat3 m = mat3(world);
    mat3 cofactors = mat3(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    base = cofactors * normal * sign(determinant(m));
#ifdef HAS_TANGENT
    along = m * tangent.xyz;
    across = m * (cross(normal, tangent.xyz) * tangent.w);
#endif
#ifdef HAS_PAGE
    vec4 put = chart;
#ifdef INSTANCED_CHART
    put = instanceChart;
#endif
    page = uv1 * put.xy + put.zw;
#endif
#ifdef ALBEDO_SET
    place = (albedoPlace * vec3(ALBEDO_UV, 1.0)).xy;
#endif
#ifdef NORMAL_SET
    bumpPlace = (normalPlace * vec3(NORMAL_UV, 1.0)).xy;
#endif
    tint = vec4(1.0);
#ifdef USE_COLOR_ALPHA
    tint = color;
#elif defined(USE_COLOR)
    tint.rgb = color;
#endif
    gl_Position = projectionMatrix * viewMatrix * position4;
}`;

const FRAGMENT = /* glsl */ `
precision highp sampler2DArray;
${lumel}
in vec3 at;
in vec3 base;
in vec2 place;
in vec2 page;
in vec2 bumpPlace;
in vec3 along;
in vec3 across;
in vec4 tint;
out vec4 result;
uniform int view;
uniform int model;
uniform float exposure;
uniform bool bumps;
uniform bool numbers;
uniform float tolerance;
uniform float asked;
uniform vec4 albedoFactor;
uniform vec3 emission;
uniform sampler2D albedoMap;
uniform sampler2D emissionMap;
uniform sampler2D normalMap;
uniform vec2 normalScale;
uniform float cutoff;
uniform sampler2DArray lightMap;
uniform sampler2D irradianceMap;
uniform sampler2D errorMap;
uniform sampler2D gradientMap;
uniform vec2 pageSize;
uniform float brightest;

vec3 bumped(vec3 n) {
#ifdef NORMAL_SET
    if (bumps) {
        vec3 t = texture(normalMap, bumpPlace).xyz * 2.0 - 1.0;
        t.xy *= normalScale;
#ifdef HAS_TANGENT
        return normalize(along * t.x + across * t.y + n * t.z);
#else
        // The frame of the texture coordinates; v points down, the map's y up.
        vec3 right = cross(dFdy(at), n);
        vec3 up = cross(n, dFdx(at));
        vec2 x = dFdx(bumpPlace);
        vec2 y = dFdy(bumpPlace);
        vec3 u = right * x.x + up * y.x;
        vec3 v = right * x.y + up * y.y;
        float size = max(dot(u, u), dot(v, v));
        float scale = size == 0.0 ? 0.0 : inversesqrt(size);
        return normalize((u * t.x - v * t.y) * scale + n * t.z);
#endif
    }
#endif
    return n;
}

vec3 irradiance(LumelLight light, vec3 n0, vec3 n) {
#ifdef HAS_LIGHT
    if (model == 1) return lumel_irradiance(light, n);
#ifdef HAS_FLUENCE
    if (model == 2) return lumel_sky_and_sun(light, n0, n);
#else
    if (model == 2) return lumel_irradiance(light, n);
#endif
#endif
#ifdef HAS_IRRADIANCE
    return texture(irradianceMap, page).rgb;
#elif defined(HAS_LIGHT)
    return lumel_irradiance(light, n0);
#else
    return vec3(0.0);
#endif
}

/** Blue, green, red for 0, 1/2, 1. */
vec3 heat(float x) {
    float y = clamp(x, 0.0, 1.0) * 2.0;
    return vec3(clamp(y - 1.0, 0.0, 1.0), 1.0 - abs(y - 1.0), clamp(1.0 - y, 0.0, 1.0));
}

vec3 encoded(vec3 c) {
    return mix(12.92 * c, 1.055 * pow(max(c, 0.0), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c));
}

void main() {
    vec3 n0 = normalize(base);
    vec3 n = bumped(n0);
    vec4 albedo = albedoFactor * tint;
    vec3 glow = emission;
#ifdef ALBEDO_SET
    albedo *= texture(albedoMap, place);
#endif
#ifdef EMISSION_MAP
    glow *= texture(emissionMap, place).rgb;
#endif
    if (albedo.a < cutoff) discard;
    LumelLight light = lumel_light(vec4(0.0), vec4(0.0), vec4(0.0));
#ifdef HAS_LIGHT
    light = lumel_light(texture(lightMap, vec3(page, 0.0)), texture(lightMap, vec3(page, 1.0)), texture(lightMap, vec3(page, 2.0)));
#endif
    vec3 e = irradiance(light, n0, n);
    if (numbers) {
        // Surfaces without a place on a page have no E.
#ifdef HAS_PAGE
        result = vec4(e, 1.0);
#else
        result = vec4(0.0);
#endif
        return;
    }
    vec3 weight = vec3(0.2126, 0.7152, 0.0722);
    vec3 g = weight.x * light.red + weight.y * light.green + weight.z * light.blue;
    vec3 shown = 1.0 - exp(-exposure * (albedo.rgb * e + 3.14159265 * glow));
#ifndef HAS_PAGE
    shown = glow == vec3(0.0) ? albedo.rgb * 0.1 : shown;
    if (view > 0) shown = vec3(0.05);
#else
    if (view == 1) shown = 1.0 - exp(-exposure * e);
    if (view == 2) shown = length(g) > 0.0 ? normalize(g) * 0.5 + 0.5 : vec3(0.0);
    float fluence = dot(weight, light.fluence);
    if (view == 3) shown = fluence > 0.0 ? heat(length(g) / fluence) : vec3(0.0);
#ifdef HAS_ERROR
    if (view == 4) shown = heat(texture(errorMap, page).r / brightest / tolerance * 0.5);
#else
    if (view == 4) shown = vec3(0.2);
#endif
    if (view == 5) {
        vec2 texel = page * pageSize;
        vec2 x = dFdx(texel);
        vec2 y = dFdy(texel);
        float area = length(cross(dFdx(at), dFdy(at)));
        float density = sqrt(abs(x.x * y.y - x.y * y.x) / max(area, 1e-20));
        float odd = mod(floor(texel.x) + floor(texel.y), 2.0);
        shown = heat(0.5 + 0.5 * log2(density / asked)) * (0.35 + 0.45 * odd);
    }
    if (view == 6) shown = vec3(1.0 - exp(-exposure * 4.0 * texture(gradientMap, page).r));
#endif
    result = vec4(encoded(shown), 1.0);
}`;

/** In the place of a picture that is not there. */
const WHITE = new THREE.DataTexture(new Uint8Array([255, 255, 255, 255]), 1, 1);
WHITE.needsUpdate = true;

const UV = ['uv', 'uv1', 'uv2'];

/** The material of a mesh: `authored` as glTF has it, on `page` (or none) at `chart`. */
export function material(authored, geometry, page, chart, instanced) {
  const defines = {};
  const set = (texture, name) => {
    const n = texture.channel ?? 0;
    if (!geometry.attributes[UV[n]]) return false;
    defines[`${name}_SET`] = n;
    defines[`${name}_UV`] = UV[n];
    texture.updateMatrix();
    return true;
  };
  const { map, normalMap, emissiveMap } = authored;
  if (map) set(map, 'ALBEDO');
  else if (emissiveMap) set(emissiveMap, 'ALBEDO');
  if (normalMap) set(normalMap, 'NORMAL');
  if (emissiveMap) defines.EMISSION_MAP = '';
  if (geometry.attributes.tangent) defines.HAS_TANGENT = '';
  if (page && geometry.attributes.uv1) {
    defines.HAS_PAGE = '';
    if (page.light) defines.HAS_LIGHT = '';
    if (page.hasFluence) defines.HAS_FLUENCE = '';
    if (page.irradiance) defines.HAS_IRRADIANCE = '';
    if (page.error) defines.HAS_ERROR = '';
    if (instanced) defines.INSTANCED_CHART = '';
  }
  const { r, g, b } = authored.color ?? new THREE.Color(1, 1, 1);
  const placed = map ?? emissiveMap;
  return new THREE.ShaderMaterial({
    glslVersion: THREE.GLSL3,
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    defines,
    side: authored.side,
    vertexColors: authored.vertexColors,
    uniforms: {
      ...shared,
      albedoFactor: { value: new THREE.Vector4(r, g, b, authored.opacity) },
      emission: {
        value: (authored.emissive ?? new THREE.Color(0, 0, 0)).clone().multiplyScalar(authored.emissiveIntensity ?? 1),
      },
      albedoMap: { value: map ?? WHITE },
      emissionMap: { value: emissiveMap ?? null },
      normalMap: { value: normalMap ?? null },
      // Without tangents three's loader turns the sign of y for its own shaders.
      normalScale: { value: new THREE.Vector2().setScalar(authored.normalScale?.x ?? 1) },
      albedoPlace: { value: placed?.matrix ?? new THREE.Matrix3() },
      normalPlace: { value: normalMap?.matrix ?? new THREE.Matrix3() },
      cutoff: { value: authored.alphaTest },
      chart: { value: chart ?? new THREE.Vector4(1, 1, 0, 0) },
      lightMap: { value: page?.light ?? null },
      irradianceMap: { value: page?.irradiance ?? null },
      errorMap: { value: page?.error ?? null },
      gradientMap: { value: null },
      pageSize: { value: page?.size ?? new THREE.Vector2(1, 1) },
      brightest: { value: page?.brightest || 1 },
    },
  });
}
