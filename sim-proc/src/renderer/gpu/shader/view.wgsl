// What every shader knows about the view. Prepended to each shader.

struct View {
    clip_from_world: mat4x4<f32>,
    // The colour of fog, and its share per metre.
    fog_rgb: vec3<f32>,
    fog_per_m: f32,
}

@group(0) @binding(0) var<uniform> view: View;
