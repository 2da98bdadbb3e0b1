//! Every shader is valid, and reads the layouts of the structs in `raster` and `vertex`.

use std::mem::offset_of;

use raster::{Placement, PlateVertex, SolidVertex, TextVertex};
use wgpu::naga;

use super::pipelines::{PLATE_WGSL, SOLID_WGSL, TEXT_WGSL, VIEW_WGSL};
use super::vertex::{Vertex, ViewUniform};

fn parsed(wgsl: &str) -> naga::Module {
    let source = format!("{VIEW_WGSL}{wgsl}");
    match naga::front::wgsl::parse_str(&source) {
        Ok(module) => module,
        Err(error) => panic!("{}", error.emit_to_string(&source)),
    }
}

/// Members of the struct called `name`: their names, offsets and types.
fn members<'m>(module: &'m naga::Module, name: &str) -> &'m [naga::StructMember] {
    let structure = module.types.iter().find(|(_, t)| t.name.as_deref() == Some(name));
    match structure.map(|(_, t)| &t.inner) {
        Some(naga::TypeInner::Struct { members, .. }) => members,
        _ => panic!("no struct {name}"),
    }
}

#[test]
fn shaders_are_valid() {
    for wgsl in [SOLID_WGSL, PLATE_WGSL, TEXT_WGSL] {
        let mut validator = naga::valid::Validator::new(
            naga::valid::ValidationFlags::all(),
            naga::valid::Capabilities::empty(),
        );
        if let Err(error) = validator.validate(&parsed(wgsl)) {
            panic!("{}", error.emit_to_string(&format!("{VIEW_WGSL}{wgsl}")));
        }
    }
}

#[test]
fn the_uniform_has_the_same_layout_in_rust_and_wgsl() {
    let module = parsed(SOLID_WGSL);
    let offsets: Vec<(&str, usize)> = members(&module, "View")
        .iter()
        .map(|member| (member.name.as_deref().unwrap(), member.offset as usize))
        .collect();
    let expected = [
        ("clip_from_world", offset_of!(ViewUniform, clip_from_world)),
        ("fog_rgb", offset_of!(ViewUniform, fog_rgb)),
        ("fog_per_m", offset_of!(ViewUniform, fog_per_m)),
    ];
    assert_eq!(offsets, expected);
    let mut layouter = naga::proc::Layouter::default();
    layouter.update(module.to_ctx()).unwrap();
    let view = module.types.iter().find(|(_, t)| t.name.as_deref() == Some("View")).unwrap().0;
    assert_eq!(layouter[view].size as usize, size_of::<ViewUniform>());
}

/// The attributes of a pipeline are the fields of the shader's `Corner`, in number and shape, and each has the offset of
/// the Rust field with the same name.
#[test]
fn vertices_have_the_same_layout_in_rust_and_wgsl() {
    let fields = |names: &[(&'static str, usize)]| names.to_vec();
    let solid = fields(&[
        ("position", offset_of!(SolidVertex, position)),
        ("colour", offset_of!(SolidVertex, colour)),
    ]);
    let placed = fields(&[("placement", offset_of!(Placement, at))]);
    let plate = fields(&[
        ("position", offset_of!(PlateVertex, position)),
        ("across", offset_of!(PlateVertex, across)),
        ("code", offset_of!(PlateVertex, code)),
    ]);
    let text = fields(&[
        ("position", offset_of!(TextVertex, position)),
        ("atlas", offset_of!(TextVertex, atlas)),
        ("ink", offset_of!(TextVertex, ink)),
        ("paper", offset_of!(TextVertex, paper)),
    ]);
    check(SOLID_WGSL, &[(solid, SolidVertex::ATTRIBUTES), (placed, Placement::ATTRIBUTES)]);
    check(PLATE_WGSL, &[(plate, PlateVertex::ATTRIBUTES)]);
    check(TEXT_WGSL, &[(text, TextVertex::ATTRIBUTES)]);
}

type Fields = Vec<(&'static str, usize)>;

fn check(wgsl: &str, buffers: &[(Fields, &[wgpu::VertexAttribute])]) {
    let module = parsed(wgsl);
    let corner = members(&module, "Corner");
    let mut fed = 0;
    for (fields, attributes) in buffers {
        assert_eq!(fields.len(), attributes.len());
        for ((name, offset), attribute) in fields.iter().zip(*attributes) {
            assert_eq!(attribute.offset as usize, *offset, "{name}");
            let member = corner.iter().find(|m| m.name.as_deref() == Some(name)).unwrap();
            let location = match member.binding {
                Some(naga::Binding::Location { location, .. }) => location,
                _ => panic!("{name} has no location"),
            };
            assert_eq!(location, attribute.shader_location, "{name}");
            let components = match module.types[member.ty].inner {
                naga::TypeInner::Vector { size, .. } => size as usize,
                _ => 1,
            };
            assert_eq!(components, self::components(attribute.format), "{name}");
            fed += 1;
        }
    }
    assert_eq!(fed, corner.len(), "every field of Corner is fed");
}

fn components(format: wgpu::VertexFormat) -> usize {
    match format {
        wgpu::VertexFormat::Uint32 => 1,
        wgpu::VertexFormat::Float32x2 => 2,
        wgpu::VertexFormat::Float32x3 => 3,
        wgpu::VertexFormat::Float32x4 | wgpu::VertexFormat::Unorm8x4 => 4,
        other => panic!("{other:?} is not used here"),
    }
}
