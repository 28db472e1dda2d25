// The surface as a camera sees it: one ray through every pixel meets the plane z = 0. `radiance` is written for the models of a
// map and appended.

struct Camera {
    // The camera's axes and centre in the surface's frame, metres: x right, y down, z forward. The w of the first two: width and
    // depth of a floor before the surface, where there is one.
    right: vec4<f32>,
    down: vec4<f32>,
    forward: vec4<f32>,
    centre: vec4<f32>,
    // fx fy cx cy, pixels; integer coordinates are pixel centres.
    lens: vec4<f32>,
    // k1 k2 p1 p2
    distortion: vec4<f32>,
    // Width and height of the surface, metres; columns and rows of texels.
    surface: vec4<f32>,
    // Gamma of the exposure, what harmonics are multiplied by, k3, and 1 for false colours, 2 for linear radiance.
    look: vec4<f32>,
    // What is seen beside the surface (RGB); smallest level of detail.
    beside: vec4<f32>,
    // Width and height of the picture, pixels; the finest level of averages that is shown.
    picture: vec4<f32>,
}

@group(0) @binding(0) var<uniform> camera: Camera;
// Number of the model (5 bits) and place of the first coefficient (27 bits), texel after texel.
@group(0) @binding(1) var texels: texture_2d<u32>;
// Vectors of four words, 4096 in a row.
@group(0) @binding(2) var coefficients: texture_2d<u32>;
// Radiance of every texel toward the camera, and averages of it.
@group(0) @binding(3) var shaded: texture_2d<f32>;
@group(0) @binding(4) var smooth_sampler: sampler;

struct Corner {
    @builtin(position) place: vec4<f32>,
    @location(0) pixel: vec2<f32>,
}

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> Corner {
    let corner = vec2<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0);
    let part = vec2<f32>(0.5 + 0.5 * corner.x, 0.5 - 0.5 * corner.y);
    return Corner(vec4<f32>(corner, 0.0, 1.0), part * camera.picture.xy - 0.5);
}

fn load(place: u32) -> vec4<u32> {
    return textureLoad(coefficients, vec2<i32>(i32(place & 4095u), i32(place >> 12u)), 0);
}

// Where the lens shows what appears at a pixel (Brown-Conrady), z = 1: a fixed point that few steps reach.
fn undistorted(pixel: vec2<f32>) -> vec2<f32> {
    let target_point = (pixel - camera.lens.zw) / camera.lens.xy;
    var u = target_point;
    if (any(camera.distortion != vec4<f32>(0.0)) || camera.look.z != 0.0) {
        for (var i = 0; i < 20; i++) {
            let r2 = dot(u, u);
            let radial = 1.0 + r2 * (camera.distortion.x + r2 * (camera.distortion.y + r2 * camera.look.z));
            let tangential = vec2<f32>(
                2.0 * camera.distortion.z * u.x * u.y + camera.distortion.w * (r2 + 2.0 * u.x * u.x),
                camera.distortion.z * (r2 + 2.0 * u.y * u.y) + 2.0 * camera.distortion.w * u.x * u.y,
            );
            u = (target_point - tangential) / radial;
        }
    }
    return u;
}

struct Hit {
    // Column and row; a texel's centre is an integer.
    at: vec2<f32>,
    direction: vec3<f32>,
    is_inside: bool,
}

fn meet(pixel: vec2<f32>) -> Hit {
    let u = undistorted(pixel);
    let ray = camera.right.xyz * u.x + camera.down.xyz * u.y + camera.forward.xyz;
    // Below the horizon of the surface there is nothing to see.
    let is_facing = ray.z < 0.0 && camera.centre.z > 0.0;
    let point = camera.centre.xy - ray.xy * (camera.centre.z / min(ray.z, -1e-20));
    let is_inside = is_facing && all(abs(point) < 0.5 * camera.surface.xy);
    let part = vec2<f32>(0.5 + point.x / camera.surface.x, 0.5 - point.y / camera.surface.y);
    return Hit(part * camera.surface.zw - 0.5, -normalize(ray), is_inside);
}

fn texel_radiance(texel: vec2<i32>, direction: vec3<f32>) -> vec3<f32> {
    let word = textureLoad(texels, texel, 0).x;
    return clamp(radiance(word >> 27u, word & 0x7ffffffu, direction), vec3<f32>(0.0), vec3<f32>(3e38));
}

// The radiance of the four texels around is blended, never their coefficients: half way between two lobes lies no lobe.
fn blended(place: vec2<f32>, direction: vec3<f32>) -> vec3<f32> {
    let last = camera.surface.zw - 1.0;
    let at = clamp(place, vec2<f32>(0.0), last);
    let first = floor(at);
    let part = at - first;
    var sum = vec3<f32>(0.0);
    for (var i = 0; i < 4; i++) {
        let step = vec2<f32>(f32(i & 1), f32(i >> 1u));
        let shares = mix(1.0 - part, part, step);
        let texel = vec2<i32>(min(first + step, last));
        sum += shares.x * shares.y * texel_radiance(texel, direction);
    }
    return sum;
}

// The reds of a false-colour picture are the brightest (Mikhailov's polynomial for the scale called turbo).
fn false_colour(y: f32) -> vec3<f32> {
    let low = vec4<f32>(1.0, y, y * y, y * y * y);
    let high = low.zw * low.z;
    return clamp(vec3<f32>(
        dot(low, vec4<f32>(0.13572138, 4.61539260, -42.66032258, 132.13108234)) + dot(high, vec2<f32>(-152.94239396, 59.28637943)),
        dot(low, vec4<f32>(0.09140261, 2.19418839, 4.84296658, -14.18503333)) + dot(high, vec2<f32>(4.27729857, 2.82956604)),
        dot(low, vec4<f32>(0.10667330, 12.64194608, -60.58204836, 110.36276771)) + dot(high, vec2<f32>(-89.90310912, 27.34824973)),
    ), vec3<f32>(0.0), vec3<f32>(1.0));
}

fn exposed(radiance: vec3<f32>) -> vec4<f32> {
    if (camera.look.w == 2.0) {
        return vec4<f32>(radiance, 1.0);
    }
    let y = 1.0 - exp(-camera.look.x * radiance);
    if (camera.look.w == 1.0) {
        return vec4<f32>(false_colour(dot(y, vec3<f32>(0.2126, 0.7152, 0.0722))), 1.0);
    }
    return vec4<f32>(y, 1.0);
}

// Every pixel evaluates the texels around its point toward itself: exact.
@fragment
fn by_pixel(corner: Corner) -> @location(0) vec4<f32> {
    let hit = meet(corner.pixel);
    if (!hit.is_inside) {
        return vec4<f32>(camera.beside.xyz, 1.0);
    }
    return exposed(blended(hit.at, hit.direction));
}

// Every texel is evaluated once, toward the camera from its own centre...
@fragment
fn shade_texel(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let part = place.xy / camera.surface.zw;
    let point = vec2<f32>(part.x - 0.5, 0.5 - part.y) * camera.surface.xy;
    let direction = normalize(camera.centre.xyz - vec3<f32>(point, 0.0));
    return vec4<f32>(min(texel_radiance(vec2<i32>(place.xy), direction), vec3<f32>(65504.0)), 1.0);
}

// ... and the picture blends these radiances, which their averages (mip levels) may replace where a pixel covers many.
@fragment
fn by_texel(corner: Corner) -> @location(0) vec4<f32> {
    let hit = meet(corner.pixel);
    let across = meet(corner.pixel + vec2<f32>(1.0, 0.0)).at - hit.at;
    let along = meet(corner.pixel + vec2<f32>(0.0, 1.0)).at - hit.at;
    if (!hit.is_inside) {
        return vec4<f32>(camera.beside.xyz, 1.0);
    }
    // The narrower side of what a pixel covers: at grazing angles rather fine than blurred. Up to two texels the blend of four misses none.
    let covered = min(dot(across, across), dot(along, along));
    let level = clamp(0.5 * log2(max(covered, 1e-12)) - 1.0, camera.picture.z, camera.beside.w);
    let at = clamp(hit.at, vec2<f32>(0.0), camera.surface.zw - 1.0);
    return exposed(textureSampleLevel(shaded, smooth_sampler, (at + 0.5) / camera.surface.zw, level).xyz);
}

// A floor along the lower edge of the surface, in front of it; `shaded` is its radiance. Nothing hides it from who stands above it.
@fragment
fn floor_before(corner: Corner) -> @location(0) vec4<f32> {
    let u = undistorted(corner.pixel);
    let ray = camera.right.xyz * u.x + camera.down.xyz * u.y + camera.forward.xyz;
    let above = camera.centre.y + 0.5 * camera.surface.y;
    let point = camera.centre.xyz + ray * (above / max(-ray.y, 1e-20));
    let part = vec2<f32>(0.5 + point.x / camera.right.w, point.z / camera.down.w);
    if (above <= 0.0 || ray.y >= 0.0 || camera.centre.z <= 0.0 || any(part < vec2<f32>(0.0)) || any(part > vec2<f32>(1.0))) {
        discard;
    }
    return exposed(textureSampleLevel(shaded, smooth_sampler, part, 0.0).xyz);
}

// cos^m near its top, where a processor's own power of a number just below 1 may lose the digits that a large m needs:
// ln x = 2 artanh((x - 1) / (x + 1)).
fn power(cosine: f32, exponent: f32) -> f32 {
    let y = (cosine - 1.0) / (cosine + 1.0);
    let q = y * y;
    let near = 2.0 * y * (1.0 + q * (0.33333333 + q * (0.2 + q * (0.14285714 + q * 0.11111111))));
    let far = log(max(cosine, 1e-30));
    return exp(exponent * select(far, near, cosine > 0.5));
}

// One level of averages from the one before it, which is bound as `shaded`.
@fragment
fn halve(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let first = vec2<i32>(place.xy) * 2;
    let last = vec2<i32>(textureDimensions(shaded)) - 1;
    var sum = vec4<f32>(0.0);
    for (var i = 0; i < 4; i++) {
        sum += textureLoad(shaded, min(first + vec2<i32>(i & 1, i >> 1u), last), 0);
    }
    return 0.25 * sum;
}
