// A picture of the target's size, laid over what is there.

@group(0) @binding(0) var overlay: texture_2d<f32>;

@vertex
fn everywhere(@builtin(vertex_index) index: u32) -> @builtin(position) vec4<f32> {
    return vec4<f32>(f32(index & 1u) * 4.0 - 1.0, f32(index >> 1u) * 4.0 - 1.0, 0.0, 1.0);
}

@fragment
fn over(@builtin(position) place: vec4<f32>) -> @location(0) vec4<f32> {
    let last = vec2<i32>(textureDimensions(overlay)) - 1;
    return textureLoad(overlay, min(vec2<i32>(place.xy), last), 0);
}
