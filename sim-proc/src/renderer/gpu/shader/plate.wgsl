// Label plates: exact, unlit colours. A pixel's colour is decided at its centre, so two bands never blend inside a
// plate; only its outer edge is anti-aliased.

// The frame's width as a share of the plate's.
override FRAME_SHARE: f32;
// The number of bands.
override BANDS: u32;

struct Corner {
    @location(0) position: vec3<f32>,
    // (0, 0) at the plate's top left corner, (1, 1) at its bottom right.
    @location(1) across: vec2<f32>,
    // Three bits (red, green, blue) per band, the top band lowest, then three for the frame.
    @location(2) code: u32,
}

struct Placed {
    @builtin(position) clip: vec4<f32>,
    @location(0) across: vec2<f32>,
    @location(1) @interpolate(flat) code: u32,
}

@vertex
fn corner(in: Corner) -> Placed {
    return Placed(view.clip_from_world * vec4(in.position, 1.0), in.across, in.code);
}

@fragment
fn pixel(in: Placed) -> @location(0) vec4<f32> {
    let inside = (in.across - FRAME_SHARE) / (1.0 - 2.0 * FRAME_SHARE);
    let framed = any(inside < vec2(0.0)) || any(inside >= vec2(1.0));
    let row = u32(clamp(inside.y, 0.0, 1.0) * f32(BANDS));
    let place = select(min(row, BANDS - 1u), BANDS, framed);
    let bits = (in.code >> (3u * place)) & 7u;
    return vec4(f32(bits & 1u), f32((bits >> 1u) & 1u), f32((bits >> 2u) & 1u), 1.0);
}
