// Light from lumel's maps, in WGSL (WebGPU, wgpu, Bevy). Copy it, or read it from `lumel::runtime::WGSL`.
//
//     let light = lumel_sample(map, map_sampler, uv);
//     let e = lumel_sky_and_sun(light, normalize(vertex_normal), bumped_normal);
//     color += albedo / 3.14159265 * e;
//
// Textures: linear filter, no sRGB. u to the right, v down: v = 0 is the upper edge of the top row, as in glTF. Normals: unit length, in
// the space of the light vectors (world, glTF axes). E and the fluence are in lux. G and the fluence are linear: filter them first, then
// call these.

// Light of the three colour channels of a texel.
struct LumelLight {
    red: vec3<f32>, // light vector G of each channel
    green: vec3<f32>,
    blue: vec3<f32>,
    fluence: vec3<f32>, // of red, green, blue
}

// From the three layers of a .ktx2: rgb is G of the layer's channel, a its fluence.
fn lumel_light(red: vec4<f32>, green: vec4<f32>, blue: vec4<f32>) -> LumelLight {
    return LumelLight(red.xyz, green.xyz, blue.xyz, vec3<f32>(red.w, green.w, blue.w));
}

// From the maps _Gr, _Gg, _Gb, _phi.
fn lumel_light_of_maps(red: vec3<f32>, green: vec3<f32>, blue: vec3<f32>, fluence: vec3<f32>) -> LumelLight {
    return LumelLight(red, green, blue, fluence);
}

// Looks a .ktx2 up at `uv`.
fn lumel_sample(map: texture_2d_array<f32>, map_sampler: sampler, uv: vec2<f32>) -> LumelLight {
    return lumel_light(
        textureSampleLevel(map, map_sampler, uv, 0, 0.0),
        textureSampleLevel(map, map_sampler, uv, 1, 0.0),
        textureSampleLevel(map, map_sampler, uv, 2, 0.0));
}

// G·n of each channel.
fn lumel_along(light: LumelLight, n: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(dot(light.red, n), dot(light.green, n), dot(light.blue, n));
}

// Irradiance at n: exact when all light is above its horizon, never too bright.
fn lumel_irradiance(light: LumelLight, n: vec3<f32>) -> vec3<f32> {
    return max(lumel_along(light, n), vec3<f32>(0.0));
}

// The most that the irradiance at n can be.
fn lumel_upper_bound(light: LumelLight, n: vec3<f32>) -> vec3<f32> {
    let along = lumel_along(light, n);
    return max(0.5 * (light.fluence + along), max(along, vec3<f32>(0.0)));
}

// Fluence of the sky in one channel: the smaller root of |g - s/2 base| = phi - s, written so that a single light has exactly none.
fn lumel_sky_fluence(g: vec3<f32>, phi: f32, base: vec3<f32>) -> f32 {
    let along = dot(g, base);
    let across = length(g - base * along);
    let root = length(vec2<f32>(phi - 2.0 * along, 1.7320508 * across));
    let size = length(g);
    let denominator = 2.0 * phi - along + root;
    if (denominator <= 0.0) {
        return 0.0;
    }
    let sky = 2.0 * (phi - size) * ((phi + size) / denominator);
    return clamp(sky, 0.0, 2.0 * max(along, 0.0));
}

fn lumel_sky_and_sun_channel(g: vec3<f32>, phi: f32, base: vec3<f32>, n: vec3<f32>) -> f32 {
    let sky = lumel_sky_fluence(g, phi, base);
    let sun = max(dot(g - base * (0.5 * sky), n), 0.0);
    return max(max(dot(g, n), 0.0), 0.25 * sky * (1.0 + dot(n, base)) + sun);
}

// Irradiance at n, taking the light for a uniform sky over the hemisphere of `base` plus one small light. `base` is the normal that was
// baked: the interpolated vertex normal, of unit length, on the side that is seen.
fn lumel_sky_and_sun(light: LumelLight, base: vec3<f32>, n: vec3<f32>) -> vec3<f32> {
    return vec3<f32>(
        lumel_sky_and_sun_channel(light.red, light.fluence.x, base, n),
        lumel_sky_and_sun_channel(light.green, light.fluence.y, base, n),
        lumel_sky_and_sun_channel(light.blue, light.fluence.z, base, n));
}

// Magnification with the maps _du, _dv: a smooth surface through four texels and their slopes instead of a bilinear one.
//
//     let at = uv * size - 0.5;    at - floor(at) is `between`; the texels are those at floor(at) + (0,0), (1,0), (0,1), (1,1)
//
// Call it once per light vector map; the fluence is filtered as before.
fn lumel_magnify(value: array<vec3<f32>, 4>, du: array<vec3<f32>, 4>, dv: array<vec3<f32>, 4>, between: vec2<f32>) -> vec3<f32> {
    let s = between;
    let one = s * s * (3.0 - 2.0 * s); // weight of the farther texel
    let leave = s * (1.0 - s) * (1.0 - s); // slope at the nearer texel
    let arrive = s * s * (s - 1.0); // slope at the farther texel
    let zero = 1.0 - one;
    let top = zero.x * value[0] + one.x * value[1] + leave.x * du[0] + arrive.x * du[1];
    let bottom = zero.x * value[2] + one.x * value[3] + leave.x * du[2] + arrive.x * du[3];
    let slope_top = zero.x * dv[0] + one.x * dv[1];
    let slope_bottom = zero.x * dv[2] + one.x * dv[3];
    return zero.y * top + one.y * bottom + leave.y * slope_top + arrive.y * slope_bottom;
}
