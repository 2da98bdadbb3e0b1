// Labels and signs: unlit ink on paper, with coverage read from the text atlas.

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

@group(1) @binding(0) var atlas: texture_2d<f32>;
@group(1) @binding(1) var atlas_sampler: sampler;

@vertex
fn corner(in: Corner) -> Placed {
    let clip = view.clip_from_world * vec4(in.position, 1.0);
    return Placed(clip, in.atlas, in.ink.rgb, in.paper.rgb);
}

// Labels are mostly seen at an angle, along an aisle: a pixel covers many texels in one direction and few in the other.
// Three samples along the longer direction, each fine enough for a third of it, are far more legible than one sample as
// coarse as the whole.
const TAPS: f32 = 3.0;

@fragment
fn pixel(in: Placed) -> @location(0) vec4<f32> {
    let texels = vec2<f32>(textureDimensions(atlas));
    let across = dpdx(in.atlas);
    let down = dpdy(in.atlas);
    let lengths = vec2(length(across * texels), length(down * texels));
    let stretch = select(down, across, lengths.x > lengths.y) / TAPS;
    let longest = max(lengths.x, lengths.y);
    let shortest = min(lengths.x, lengths.y);
    let level = log2(max(max(shortest, longest / TAPS), 1e-6));
    let coverage = (
        textureSampleLevel(atlas, atlas_sampler, in.atlas - stretch, level).r
        + textureSampleLevel(atlas, atlas_sampler, in.atlas, level).r
        + textureSampleLevel(atlas, atlas_sampler, in.atlas + stretch, level).r
    ) / TAPS;
    return vec4(mix(in.paper, in.ink, coverage), 1.0);
}
