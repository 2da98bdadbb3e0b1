// Labels and signs: ink on paper, both unlit, with the lettering's coverage read from an atlas.

struct Corner {
    @location(0) position: vec3<f32>,
    @location(1) atlas: vec2<f32>,
    @location(2) ink: vec4<f32>,
    @location(3) paper: vec4<f32>,
}

struct Placed {
    @builtin(position) clip: vec4<f32>,
    @location(0) atlas: vec2<f32>,
    @location(1) @interpolate(flat) ink: vec3<f32>,
    @location(2) @interpolate(flat) paper: vec3<f32>,
}

@group(1) @binding(0) var lettering: texture_2d<f32>;
@group(1) @binding(1) var lettering_sampler: sampler;

@vertex
fn corner(in: Corner) -> Placed {
    let clip = view.clip_from_world * vec4(in.position, 1.0);
    return Placed(clip, in.atlas, in.ink.rgb, in.paper.rgb);
}

// Labels are mostly seen aslant, along an aisle: a pixel covers a long stretch of text one way and a
// short one the other. Three samples along the stretch, each fine enough for a third of it, read far
// better than one that is as coarse as the whole; a device's own anisotropic filter costs the software
// driver several times as much.
const TAPS: f32 = 3.0;

@fragment
fn pixel(in: Placed) -> @location(0) vec4<f32> {
    let texels = vec2<f32>(textureDimensions(lettering));
    let across = dpdx(in.atlas);
    let down = dpdy(in.atlas);
    let lengths = vec2(length(across * texels), length(down * texels));
    let stretch = select(down, across, lengths.x > lengths.y) / TAPS;
    let longest = max(lengths.x, lengths.y);
    let shortest = min(lengths.x, lengths.y);
    let level = log2(max(max(shortest, longest / TAPS), 1e-6));
    let coverage = (
        textureSampleLevel(lettering, lettering_sampler, in.atlas - stretch, level).r
        + textureSampleLevel(lettering, lettering_sampler, in.atlas, level).r
        + textureSampleLevel(lettering, lettering_sampler, in.atlas + stretch, level).r
    ) / TAPS;
    return vec4(mix(in.paper, in.ink, coverage), 1.0);
}
