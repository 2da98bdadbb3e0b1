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

@fragment
fn pixel(in: Placed) -> @location(0) vec4<f32> {
    let coverage = textureSample(lettering, lettering_sampler, in.atlas).r;
    return vec4(mix(in.paper, in.ink, coverage), 1.0);
}
