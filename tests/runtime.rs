//! The shader snippets: valid in both languages, and as good as their counterparts in Rust.

use std::fs;

use glam::{Vec2, Vec3};
use lumel::runtime;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use naga::{Module, ShaderStage, front};

use crate::browser;
use crate::support::Rng;

/// Cases side by side; row by row: light of red, green, blue (G, φ); base normal; normal; four values, derivatives along u, along v;
/// place between. What comes out, row by row: irradiance, upper bound, sky and sun, magnification.
const INPUT_ROWS: usize = 18;
const OUTPUT_ROWS: usize = 4;
const CASES: usize = 256;

const GLSL_HARNESS: &str = "
uniform highp sampler2D cases;
out vec4 color;
vec4 number(int row) { return texelFetch(cases, ivec2(int(gl_FragCoord.x), row), 0); }
void main() {
    LumelLight light = lumel_light(number(0), number(1), number(2));
    vec3 base = number(3).xyz;
    vec3 n = number(4).xyz;
    vec3 value[4];
    vec3 du[4];
    vec3 dv[4];
    for (int i = 0; i < 4; i++) {
        value[i] = number(5 + i).xyz;
        du[i] = number(9 + i).xyz;
        dv[i] = number(13 + i).xyz;
    }
    vec3 result = lumel_magnify(value, du, dv, number(17).xy);
    int row = int(gl_FragCoord.y);
    if (row == 0) result = lumel_irradiance(light, n);
    if (row == 1) result = lumel_upper_bound(light, n);
    if (row == 2) result = lumel_sky_and_sun(light, base, n);
    color = vec4(result, 1.0);
}";

const WGSL_HARNESS: &str = "
@group(0) @binding(0) var cases: texture_2d<f32>;
fn number(x: i32, row: i32) -> vec4<f32> { return textureLoad(cases, vec2<i32>(x, row), 0); }
@fragment
fn main(@builtin(position) position: vec4<f32>) -> @location(0) vec4<f32> {
    let x = i32(position.x);
    let light = lumel_light(number(x, 0), number(x, 1), number(x, 2));
    let base = number(x, 3).xyz;
    let n = number(x, 4).xyz;
    var value: array<vec3<f32>, 4>;
    var du: array<vec3<f32>, 4>;
    var dv: array<vec3<f32>, 4>;
    for (var i = 0; i < 4; i++) {
        value[i] = number(x, 5 + i).xyz;
        du[i] = number(x, 9 + i).xyz;
        dv[i] = number(x, 13 + i).xyz;
    }
    var result = lumel_magnify(value, du, dv, number(x, 17).xy);
    let row = i32(position.y);
    if (row == 0) { result = lumel_irradiance(light, n); }
    if (row == 1) { result = lumel_upper_bound(light, n); }
    if (row == 2) { result = lumel_sky_and_sun(light, base, n); }
    return vec4<f32>(result, 1.0);
}";

fn validate(module: &Module) -> ModuleInfo {
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(module)
        .unwrap_or_else(|error| panic!("{error:?}"))
}

fn wgsl() -> Module {
    let source = format!("{}{WGSL_HARNESS}", runtime::WGSL);
    front::wgsl::parse_str(&source).unwrap_or_else(|e| panic!("{}", e.emit_to_string(&source)))
}

/// The WGSL snippet and its harness in the language of `WebGL2`.
fn wgsl_as_glsl() -> String {
    let module = wgsl();
    let info = validate(&module);
    let options = naga::back::glsl::Options {
        version: naga::back::glsl::Version::new_gles(300),
        ..Default::default()
    };
    let pipeline = naga::back::glsl::PipelineOptions {
        shader_stage: ShaderStage::Fragment,
        entry_point: "main".to_owned(),
        multiview: None,
    };
    let mut text = String::new();
    naga::back::glsl::Writer::new(
        &mut text,
        &module,
        &info,
        &options,
        &pipeline,
        naga::proc::BoundsCheckPolicies::default(),
    )
    .and_then(|mut writer| writer.write())
    .unwrap_or_else(|error| panic!("{error}"));
    text
}

#[test]
fn the_wgsl_is_valid() {
    validate(&wgsl());
}

#[test]
fn the_glsl_is_valid_for_vulkan() {
    let source = format!(
        "#version 450\n{}\nlayout(location = 0) in vec3 n;\nlayout(location = 0) out vec4 color;\n\
         void main() {{ color = vec4(lumel_sky_and_sun(lumel_light(vec4(1.0), vec4(2.0), vec4(3.0)), vec3(0.0, 0.0, 1.0), n), 1.0); }}",
        runtime::GLSL
    );
    let module = front::glsl::Frontend::default()
        .parse(&front::glsl::Options::from(ShaderStage::Fragment), &source)
        .unwrap_or_else(|errors| panic!("{}", errors.emit_to_string(&source)));
    validate(&module);
}

#[test]
fn both_languages_have_the_same_functions() {
    let names = |text: &str, opening: fn(&str) -> Option<&str>| -> Vec<String> {
        let named = text.lines().filter_map(opening);
        named
            .filter_map(|rest| rest.split_once('('))
            .map(|(name, _)| name.to_owned())
            .filter(|name| name.starts_with("lumel_"))
            .collect()
    };
    let in_glsl = names(runtime::GLSL, |line| {
        let (kind, rest) = line.split_once(' ')?;
        ["float", "vec3", "LumelLight"]
            .contains(&kind)
            .then_some(rest)
    });
    let mut in_wgsl = names(runtime::WGSL, |line| line.strip_prefix("fn "));
    // Textures are parameters in WGSL only.
    in_wgsl.retain(|name| name != "lumel_sample");
    assert_eq!(in_glsl, in_wgsl);
    assert_eq!(in_glsl.len(), 9);
}

/// One case as the rows of its column.
struct Case([[f32; 4]; INPUT_ROWS]);

impl Case {
    /// Light as texels have it: never more light vector than fluence, from one side only or from all of them; now and then none.
    fn random(seed: u64) -> Self {
        let mut rng = Rng::new(seed);
        let base = rng.direction();
        let mut rows = [[0.0; 4]; INPUT_ROWS];
        let strength = 10.0_f64.powf(rng.range(-3.0, 4.0));
        for row in &mut rows[..3] {
            let towards = rng.direction();
            let towards = towards * towards.dot(base).signum();
            let size = if seed.is_multiple_of(16) {
                0.0
            } else {
                strength * rng.unit()
            };
            let spread = [1.0, 1.0 + rng.unit(), 4.0][seed as usize % 3];
            *row = (towards * size)
                .as_vec3()
                .extend((size * spread) as f32)
                .to_array();
        }
        rows[3] = base.as_vec3().extend(0.0).to_array();
        rows[4] = rng.direction().as_vec3().extend(0.0).to_array();
        for row in &mut rows[5..17] {
            *row = (rng.direction() * strength)
                .as_vec3()
                .extend(0.0)
                .to_array();
        }
        rows[17] = [rng.unit() as f32, rng.unit() as f32, 0.0, 0.0];
        Self(rows)
    }

    fn vector(&self, row: usize) -> Vec3 {
        Vec3::from_slice(&self.0[row])
    }

    /// What Rust makes of it, and how large the numbers are that went in.
    fn expected(&self) -> ([[f32; 3]; OUTPUT_ROWS], f32) {
        let [base, n] = [3, 4].map(|row| self.vector(row));
        let channels = [0, 1, 2].map(|row| (self.vector(row), self.0[row][3]));
        let four = |first: usize| [0, 1, 2, 3].map(|i| self.vector(first + i));
        let [x, y, ..] = self.0[17];
        let between = Vec2::new(x, y);
        let all = [
            channels.map(|(g, _)| runtime::irradiance(g, n)),
            channels.map(|(g, phi)| runtime::bounds(g, phi, n)[1]),
            channels.map(|(g, phi)| runtime::sky_and_sun(g, phi, base, n)),
            runtime::magnify(four(5), four(9), four(13), between).to_array(),
        ];
        let size = self.0.iter().flatten().fold(0.0_f32, |m, x| m.max(x.abs()));
        (all, size)
    }
}

/// Draws `fragment` over the cases and writes what comes out, as JSON, into the page.
fn page(fragment: &str, cases: &[Case]) -> String {
    let numbers: Vec<f32> = (0..INPUT_ROWS)
        .flat_map(|row| cases.iter().flat_map(move |case| case.0[row]))
        .collect();
    format!(
        "<pre id=\"result\"></pre><script>
const [width, inputs, outputs] = [{CASES}, {INPUT_ROWS}, {OUTPUT_ROWS}];
const gl = document.createElement('canvas').getContext('webgl2');
gl.getExtension('EXT_color_buffer_float');
const program = gl.createProgram();
const problems = [];
for (const [type, text] of [
  [gl.VERTEX_SHADER, `#version 300 es
void main() {{ gl_Position = vec4(float(gl_VertexID % 2) * 4.0 - 1.0, float(gl_VertexID / 2) * 4.0 - 1.0, 0.0, 1.0); }}`],
  [gl.FRAGMENT_SHADER, {fragment}],
]) {{
  const shader = gl.createShader(type);
  gl.shaderSource(shader, text);
  gl.compileShader(shader);
  problems.push(gl.getShaderInfoLog(shader));
  gl.attachShader(program, shader);
}}
gl.linkProgram(program);
gl.useProgram(program);
const texture = (rows, data) => {{
  const texture = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, texture);
  gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA32F, width, rows);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
  gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
  if (data) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, width, rows, gl.RGBA, gl.FLOAT, data);
  return texture;
}};
const target = texture(outputs);
gl.bindFramebuffer(gl.FRAMEBUFFER, gl.createFramebuffer());
gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, target, 0);
texture(inputs, new Float32Array({numbers}));
gl.viewport(0, 0, width, outputs);
gl.drawArrays(gl.TRIANGLES, 0, 3);
const values = new Float32Array(4 * width * outputs);
gl.readPixels(0, 0, width, outputs, gl.RGBA, gl.FLOAT, values);
document.getElementById('result').textContent = JSON.stringify({{ problems: problems.join(''), values: Array.from(values) }});
</script>",
        fragment = serde_json::to_string(fragment).expect("a text"),
        numbers = serde_json::to_string(&numbers).expect("finite numbers"),
    )
}

#[test]
fn a_graphics_driver_computes_what_rust_does() {
    let Some(chromium) = browser::find() else {
        return;
    };
    let glsl = format!(
        "#version 300 es\nprecision highp float;\n{}{GLSL_HARNESS}",
        runtime::GLSL
    );
    let cases: Vec<Case> = (0..CASES as u64).map(Case::random).collect();
    let folder = tempfile::tempdir().expect("temporary folder");
    for (language, fragment) in [("glsl", glsl), ("wgsl", wgsl_as_glsl())] {
        let file = folder.path().join(format!("{language}.html"));
        fs::write(&file, page(&fragment, &cases)).expect("writable");
        let said = browser::result(chromium, &file, "");
        assert_eq!(said["problems"], "", "{language}");
        for (index, case) in cases.iter().enumerate() {
            let (expected, size) = case.expected();
            for (row, expected) in expected.iter().enumerate() {
                for (channel, want) in expected.iter().enumerate() {
                    let at = 4 * (row * CASES + index) + channel;
                    let got = said["values"][at].as_f64().expect("a number") as f32;
                    // Some tens of roundings; drivers may divide and take roots less exactly than Rust does.
                    assert!(
                        (got - want).abs() <= 2e-5 * size,
                        "{language}, case {index}, row {row}: {got} for {want}"
                    );
                }
            }
        }
    }
}
