// Lit triangles. Light is baked into the vertex colours, so only fog is left: it is linear in depth, so interpolating
// it between vertices is exact.

struct Corner {
    @location(0) position: vec3<f32>,
    // Alpha is the share of fog that the surface takes: 0 for lamps.
    @location(1) colour: vec4<f32>,
    // Where this instance stands: (x, y) in metres, cosine and sine of its rotation about z.
    @location(2) placement: vec4<f32>,
}

struct Shaded {
    @builtin(position) clip: vec4<f32>,
    @location(0) colour: vec3<f32>,
}

@vertex
fn corner(in: Corner) -> Shaded {
    let p = in.position;
    let turn = in.placement.zw;
    let world = vec3(
        in.placement.x + turn.x * p.x - turn.y * p.y,
        in.placement.y + turn.y * p.x + turn.x * p.y,
        p.z,
    );
    let clip = view.clip_from_world * vec4(world, 1.0);
    let fog = clamp(clip.w * view.fog_per_m, 0.0, 1.0) * in.colour.a;
    return Shaded(clip, mix(in.colour.rgb, view.fog_rgb, fog));
}

@fragment
fn pixel(in: Shaded) -> @location(0) vec4<f32> {
    return vec4(in.colour, 1.0);
}
