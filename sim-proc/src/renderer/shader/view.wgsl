// What every shader of the renderer knows about the view. Prepended to each of them.

struct View {
    clip_from_world: mat4x4<f32>,
    // The colour of distance, and how much of it each metre ahead adds.
    fog_rgb: vec3<f32>,
    fog_per_m: f32,
}

@group(0) @binding(0) var<uniform> view: View;
