// Light from lumel's maps, in GLSL: ES 3.00 (WebGL2), 3.30 and later, Vulkan. Copy it, or read it from `lumel::runtime::GLSL`.
//
//     LumelLight light = lumel_light(texture(map, vec3(uv, 0.0)), texture(map, vec3(uv, 1.0)), texture(map, vec3(uv, 2.0)));
//     vec3 e = lumel_sky_and_sun(light, normalize(vertex_normal), bumped_normal);
//     color += albedo / 3.14159265 * e;
//
// Textures: linear filter, no sRGB. u to the right, v down: v = 0 is the upper edge of the top row, as in glTF; with a texture whose
// first row is at v = 1, look up at 1 - v. Normals: unit length, in the space of the light vectors (world, glTF axes). E and the fluence
// are in lux. G and the fluence are linear: filter them first, then call these. Needs highp.

// Light of the three colour channels of a texel.
struct LumelLight {
    vec3 red; // light vector G of each channel
    vec3 green;
    vec3 blue;
    vec3 fluence; // of red, green, blue
};

// From the three layers of a .ktx2: rgb is G of the layer's channel, a its fluence.
LumelLight lumel_light(vec4 red, vec4 green, vec4 blue) {
    return LumelLight(red.xyz, green.xyz, blue.xyz, vec3(red.w, green.w, blue.w));
}

// From the maps _Gr, _Gg, _Gb, _phi.
LumelLight lumel_light_of_maps(vec3 red, vec3 green, vec3 blue, vec3 fluence) {
    return LumelLight(red, green, blue, fluence);
}

// G·n of each channel.
vec3 lumel_along(LumelLight light, vec3 n) {
    return vec3(dot(light.red, n), dot(light.green, n), dot(light.blue, n));
}

// Irradiance at n: exact when all light is above its horizon, never too bright.
vec3 lumel_irradiance(LumelLight light, vec3 n) {
    return max(lumel_along(light, n), vec3(0.0));
}

// The most that the irradiance at n can be.
vec3 lumel_upper_bound(LumelLight light, vec3 n) {
    vec3 along = lumel_along(light, n);
    return max(0.5 * (light.fluence + along), max(along, vec3(0.0)));
}

// Fluence of the sky in one channel: the smaller root of |g - s/2 base| = phi - s, written so that a single light has exactly none.
float lumel_sky_fluence(vec3 g, float phi, vec3 base) {
    float along = dot(g, base);
    float across = length(g - base * along);
    float root = length(vec2(phi - 2.0 * along, 1.7320508 * across));
    float size = length(g);
    float denominator = 2.0 * phi - along + root;
    if (denominator <= 0.0) {
        return 0.0;
    }
    float sky = 2.0 * (phi - size) * ((phi + size) / denominator);
    return clamp(sky, 0.0, 2.0 * max(along, 0.0));
}

float lumel_sky_and_sun_channel(vec3 g, float phi, vec3 base, vec3 n) {
    float sky = lumel_sky_fluence(g, phi, base);
    float sun = max(dot(g - base * (0.5 * sky), n), 0.0);
    return max(max(dot(g, n), 0.0), 0.25 * sky * (1.0 + dot(n, base)) + sun);
}

// Irradiance at n, taking the light for a uniform sky over the hemisphere of `base` plus one small light. `base` is the normal that was
// baked: the interpolated vertex normal, of unit length, on the side that is seen.
vec3 lumel_sky_and_sun(LumelLight light, vec3 base, vec3 n) {
    return vec3(
        lumel_sky_and_sun_channel(light.red, light.fluence.x, base, n),
        lumel_sky_and_sun_channel(light.green, light.fluence.y, base, n),
        lumel_sky_and_sun_channel(light.blue, light.fluence.z, base, n));
}

// Magnification with the maps _du, _dv: a smooth surface through four texels and their slopes instead of a bilinear one.
//
//     vec2 at = uv * size - 0.5;    at - floor(at) is `between`; the texels are those at floor(at) + (0,0), (1,0), (0,1), (1,1)
//
// Call it once per light vector map; the fluence is filtered as before.
vec3 lumel_magnify(vec3 value[4], vec3 du[4], vec3 dv[4], vec2 between) {
    vec2 s = between;
    vec2 one = s * s * (3.0 - 2.0 * s); // weight of the farther texel
    vec2 leave = s * (1.0 - s) * (1.0 - s); // slope at the nearer texel
    vec2 arrive = s * s * (s - 1.0); // slope at the farther texel
    vec2 zero = 1.0 - one;
    vec3 top = zero.x * value[0] + one.x * value[1] + leave.x * du[0] + arrive.x * du[1];
    vec3 bottom = zero.x * value[2] + one.x * value[3] + leave.x * du[2] + arrive.x * du[3];
    vec3 slope_top = zero.x * dv[0] + one.x * dv[1];
    vec3 slope_bottom = zero.x * dv[2] + one.x * dv[3];
    return zero.y * top + one.y * bottom + leave.y * slope_top + arrive.y * slope_bottom;
}
