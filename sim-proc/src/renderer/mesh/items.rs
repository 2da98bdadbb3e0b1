//! The items on the shelves: one mesh for each shape of the catalogue.
//!
//! A mesh stands on z = 0 with its front towards -y, and is at most 0.6 m wide, 0.52 m deep and 0.5 m high. Each has the
//! details by which a person recognises it.

use nalgebra::Vector3;
use warehouse::Shape;

use super::builder::{Detail, Material, Mesh, MeshBuilder};

const BLACK: Material = Material::glossy([34, 35, 38]);
const DARK: Material = Material::dull([48, 50, 54]);
const STEEL: Material = Material::glossy([168, 174, 180]);
const WHITE: Material = Material::dull([238, 238, 234]);
const WOOD: Material = Material::dull([196, 160, 112]);

/// The mesh of an item of `shape` with main colour `rgb`.
pub(crate) fn item(shape: Shape, rgb: [u8; 3], detail: Detail) -> Mesh {
    let mut builder = MeshBuilder::new(detail);
    let b = &mut builder;
    match shape {
        Shape::Barrel => barrel(b, Material::glossy(rgb)),
        Shape::Carton => carton(b, Material::dull(rgb)),
        Shape::Toolbox => toolbox(b, Material::glossy(rgb)),
        Shape::FireExtinguisher => fire_extinguisher(b, Material::glossy(rgb)),
        Shape::Cone => cone(b, Material::dull(rgb)),
        Shape::Tyre => tyre(b, Material::dull(rgb)),
        Shape::Bucket => bucket(b, Material::glossy(rgb)),
        Shape::Helmet => helmet(b, Material::glossy(rgb)),
        Shape::Crate => crate_of_slats(b, Material::dull(rgb)),
        Shape::Jerrycan => jerrycan(b, Material::glossy(rgb)),
        Shape::GasCylinder => gas_cylinder(b, Material::glossy(rgb)),
        Shape::CableReel => cable_reel(b, Material::dull(rgb)),
    }
    builder.finish()
}

/// A steel drum: three hoops, a rim, a sunken lid with its bung.
fn barrel(b: &mut MeshBuilder, paint: Material) {
    let hoop =
        |z: f32| [[0.19, z - 0.018], [0.205, z - 0.006], [0.205, z + 0.006], [0.19, z + 0.018]];
    b.material(paint);
    let mut profile = vec![[0.195, 0.0], [0.2, 0.012], [0.19, 0.024]];
    profile.extend(hoop(0.16));
    profile.extend(hoop(0.30));
    profile.push([0.19, 0.43]);
    b.smooth_body(&profile, 20);
    b.material(paint.shaded(0.55));
    b.turned_body(
        &[[0.19, 0.43], [0.202, 0.434], [0.202, 0.452], [0.186, 0.452], [0.184, 0.436]],
        20,
    );
    b.turned_body(&[[0.184, 0.436], [0.0, 0.436]], 20);
    b.material(STEEL);
    b.moved([0.06, -0.1, 0.436], |b| b.turned_body(&[[0.03, 0.0], [0.03, 0.02], [0.0, 0.02]], 8));
}

/// A cardboard box with tape over the seam and open upper flaps.
fn carton(b: &mut MeshBuilder, card: Material) {
    let (w, d, h) = (0.2, 0.19, 0.31);
    b.material(card);
    b.block([-w, -d, 0.0], [w, d, h]);
    for side in [-1.0, 1.0] {
        // A flap leans outward from the upper edge and is visible from both sides.
        let (x0, x1, z1) = (side * w, side * (w + 0.075), h + 0.085);
        let flap = [[x0, -d, h], [x1, -d, z1], [x1, d, z1], [x0, d, h]];
        let mut other = flap;
        other.reverse();
        b.material(card.shaded(0.92));
        b.polygon(&flap);
        b.material(card.shaded(0.78));
        b.polygon(&other);
    }
    let tape = Material::glossy([214, 196, 150]);
    b.material(if card.rgb[2] > 200 { Material::glossy([190, 168, 120]) } else { tape });
    b.block([-0.03, -d - 0.003, 0.13], [0.03, d, h + 0.003]);
    // Printed marks: two arrows upward and a box of small print.
    b.material(card.shaded(0.42));
    let y = -d - 0.003;
    for x in [-0.15, -0.09] {
        b.prism(&[[x - 0.022, 0.10], [x + 0.022, 0.10], [x, 0.135]], y, y + 0.002);
        b.block([x - 0.008, y, 0.06], [x + 0.008, y + 0.002, 0.10]);
    }
    b.block([-0.175, y, 0.04], [-0.065, y + 0.002, 0.05]);
    b.block([0.075, y, 0.05], [0.17, y + 0.002, 0.13]);
    b.material(card.shaded(0.97));
    b.block([0.085, y - 0.002, 0.095], [0.16, y, 0.12]);
    b.block([0.085, y - 0.002, 0.062], [0.135, y, 0.08]);
}

/// A long box with a ridged lid, two clasps and a carrying handle.
fn toolbox(b: &mut MeshBuilder, paint: Material) {
    b.material(paint);
    b.bevelled([-0.26, -0.12, 0.0], [0.26, 0.12, 0.19], 0.012);
    b.material(DARK);
    b.block([-0.255, -0.115, 0.185], [0.255, 0.115, 0.2]);
    b.material(paint.shaded(0.93));
    b.turned(Vector3::z_axis(), 90.0, |b| {
        let lid = [
            [-0.125, 0.2],
            [0.125, 0.2],
            [0.125, 0.23],
            [0.07, 0.29],
            [-0.07, 0.29],
            [-0.125, 0.23],
        ];
        b.prism(&lid, -0.265, 0.265);
    });
    b.material(STEEL);
    for x in [-0.16, 0.16] {
        b.block_without([x - 0.025, -0.137, 0.14], [x + 0.025, -0.12, 0.225], &[]);
    }
    b.material(BLACK);
    let handle = [
        [-0.14, 0.0, 0.28],
        [-0.13, 0.0, 0.36],
        [-0.1, 0.0, 0.385],
        [0.1, 0.0, 0.385],
        [0.13, 0.0, 0.36],
        [0.14, 0.0, 0.28],
    ];
    b.tube(&handle, 0.016, 6);
    b.material(paint.shaded(0.6));
    b.block([-0.09, -0.123, 0.06], [0.09, -0.12, 0.12]);
}

/// A slim bottle with lever, gauge, white label, and a hose that ends in a horn.
fn fire_extinguisher(b: &mut MeshBuilder, paint: Material) {
    b.material(BLACK);
    b.turned_body(&[[0.102, 0.0], [0.102, 0.025], [0.1, 0.025]], 16);
    b.material(paint);
    b.turned_body(&[[0.1, 0.025], [0.1, 0.3]], 16);
    b.smooth_body(&[[0.1, 0.3], [0.088, 0.335], [0.06, 0.358], [0.03, 0.368]], 16);
    b.material(STEEL);
    b.turned_body(&[[0.028, 0.365], [0.028, 0.4], [0.0, 0.4]], 8);
    // The label, wrapped around the front.
    b.material(WHITE);
    wrapped(b, 0.1015, [0.12, 0.235], 52.0);
    b.material(paint.shaded(0.75));
    wrapped(b, 0.1025, [0.19, 0.222], 44.0);
    b.material(DARK);
    for z in [0.135, 0.152, 0.168] {
        wrapped(b, 0.1025, [z, z + 0.007], 40.0);
    }
    // Grip and lever, one above the other, out to the left.
    b.material(BLACK);
    b.block_without([-0.035, -0.028, 0.385], [0.03, 0.028, 0.42], &[]);
    b.prism(&[[-0.15, 0.372], [-0.03, 0.392], [-0.03, 0.408], [-0.15, 0.388]], -0.016, 0.016);
    b.material(paint.shaded(0.8));
    b.prism(&[[-0.16, 0.452], [0.02, 0.42], [0.02, 0.436], [-0.16, 0.47]], -0.016, 0.016);
    b.material(WHITE);
    b.moved([0.0, -0.028, 0.4], |b| {
        b.turned(Vector3::x_axis(), 90.0, |b| {
            b.turned_body(&[[0.021, 0.0], [0.021, 0.008], [0.0, 0.008]], 10)
        });
    });
    b.material(BLACK);
    b.tube(
        &[
            [0.03, 0.0, 0.4],
            [0.1, -0.01, 0.41],
            [0.15, -0.02, 0.36],
            [0.152, -0.025, 0.2],
            [0.145, -0.03, 0.12],
        ],
        0.014,
        6,
    );
    b.moved([0.145, -0.03, 0.03], |b| b.turned_body(&[[0.0, 0.0], [0.03, 0.0], [0.016, 0.1]], 8));
}

/// A strip on the front of a bottle of this `radius`, `half_angle` degrees to each side.
fn wrapped(b: &mut MeshBuilder, radius: f32, [low, high]: [f32; 2], half_angle: f32) {
    let steps = 6;
    let at = |i: u32| {
        let angle = (-90.0 - half_angle + 2.0 * half_angle * i as f32 / steps as f32).to_radians();
        [radius * angle.cos(), radius * angle.sin()]
    };
    for i in 0..steps {
        let ([x0, y0], [x1, y1]) = (at(i), at(i + 1));
        b.polygon(&[[x0, y0, low], [x1, y1, low], [x1, y1, high], [x0, y0, high]]);
    }
}

/// A traffic cone on a square foot, with two white bands.
fn cone(b: &mut MeshBuilder, paint: Material) {
    b.material(paint.shaded(0.72));
    b.bevelled([-0.2, -0.2, 0.0], [0.2, 0.2, 0.035], 0.012);
    let radius = |z: f32| 0.155 - (z - 0.035) * 0.29;
    let stretch = |b: &mut MeshBuilder, low: f32, high: f32| {
        b.turned_body(&[[radius(low), low], [radius(high), high]], 20);
    };
    b.material(paint);
    stretch(b, 0.035, 0.16);
    stretch(b, 0.25, 0.31);
    stretch(b, 0.37, 0.475);
    b.turned_body(&[[radius(0.475), 0.475], [0.0, 0.48]], 20);
    b.material(Material::dull([246, 246, 246]));
    stretch(b, 0.16, 0.25);
    stretch(b, 0.31, 0.37);
}

/// An upright tyre, its hole towards the viewer, with treads.
fn tyre(b: &mut MeshBuilder, rubber: Material) {
    let (inner, outer, half) = (0.125, 0.225, 0.09);
    b.moved([0.0, 0.0, outer + 0.012], |b| {
        b.turned(Vector3::x_axis(), 90.0, |b| {
            b.material(rubber.shaded(0.8));
            b.turned_body(&[[inner, half - 0.02], [inner, -half + 0.02]], 24);
            b.material(rubber);
            b.smooth_body(
                &[
                    [inner, -half + 0.02],
                    [inner + 0.03, -half],
                    [outer - 0.04, -half],
                    [outer - 0.008, -half + 0.025],
                    [outer, -half + 0.05],
                ],
                24,
            );
            b.smooth_body(
                &[
                    [outer, half - 0.05],
                    [outer - 0.008, half - 0.025],
                    [outer - 0.04, half],
                    [inner + 0.03, half],
                    [inner, half - 0.02],
                ],
                24,
            );
            b.turned_body(&[[outer, -half + 0.05], [outer, half - 0.05]], 24);
            // A raised ring on the side wall, and the treads.
            let light = if rubber.rgb[0] < 80 { rubber.shaded(1.9) } else { rubber.shaded(0.72) };
            b.material(light);
            b.turned_body(&[[inner + 0.045, half + 0.004], [inner + 0.036, half + 0.004]], 24);
            b.material(rubber.shaded(0.86));
            for i in 0..20 {
                b.turned(Vector3::z_axis(), i as f32 * 18.0, |b| {
                    b.block_without(
                        [outer - 0.012, -0.021, -half + 0.015],
                        [outer + 0.012, 0.021, half - 0.015],
                        &[super::builder::Side::Left],
                    );
                });
            }
        });
    });
}

/// A bucket, wider at the top, with an upright handle.
fn bucket(b: &mut MeshBuilder, paint: Material) {
    b.material(paint);
    b.turned_body(&[[0.135, 0.0], [0.172, 0.225]], 20);
    b.turned_body(
        &[
            [0.172, 0.225],
            [0.182, 0.225],
            [0.186, 0.255],
            [0.175, 0.29],
            [0.19, 0.292],
            [0.19, 0.308],
            [0.176, 0.308],
        ],
        20,
    );
    b.material(paint.shaded(0.5));
    b.turned_body(&[[0.176, 0.308], [0.135, 0.02], [0.0, 0.02]], 20);
    b.material(DARK);
    for x in [-0.19, 0.19] {
        b.block_without([x - 0.014, -0.02, 0.25], [x + 0.014, 0.02, 0.285], &[]);
    }
    b.material(STEEL);
    let bail: Vec<[f32; 3]> = (0..=8)
        .map(|i| {
            let angle = std::f32::consts::PI * i as f32 / 8.0;
            [0.195 * angle.cos(), -0.03 * angle.sin(), 0.27 + 0.2 * angle.sin()]
        })
        .collect();
    b.tube(&bail, 0.008, 5);
    b.material(BLACK);
    b.tube(&[[-0.06, -0.03, 0.467], [0.06, -0.03, 0.467]], 0.018, 6);
}

/// A hard hat with peak and ridges, on a plain stand.
fn helmet(b: &mut MeshBuilder, shell: Material) {
    b.material(Material::dull([92, 97, 104]));
    b.turned_body(&[[0.11, 0.0], [0.11, 0.02], [0.045, 0.03], [0.045, 0.15], [0.1, 0.17]], 10);
    b.moved([0.0, 0.03, 0.16], |b| {
        let dome: Vec<[f32; 2]> = (0..=7)
            .map(|i| {
                let angle = std::f32::consts::FRAC_PI_2 * i as f32 / 7.0;
                [(0.185 * angle.cos()).max(0.0), 0.035 + 0.205 * angle.sin()]
            })
            .collect();
        b.material(shell);
        b.turned_body(&[[0.185, 0.012], [0.185, 0.035]], 20);
        b.smooth_body(&dome, 20);
        // The brim all around, longer in front as a peak.
        b.turned_body(&[[0.175, 0.0], [0.207, 0.0], [0.207, 0.014], [0.18, 0.022]], 20);
        let peak: Vec<[f32; 2]> = (0..=8)
            .map(|i| {
                let angle = std::f32::consts::PI * (1.0 + i as f32 / 8.0);
                [0.17 * angle.cos(), -0.1 + 0.16 * angle.sin()]
            })
            .collect();
        let upper: Vec<[f32; 3]> =
            peak.iter().map(|&[x, y]| [x, y, 0.024 + 0.16 * (y + 0.1)]).collect();
        let lower: Vec<[f32; 3]> =
            peak.iter().map(|&[x, y]| [x, y, 0.008 + 0.16 * (y + 0.1)]).collect();
        b.material(shell.shaded(0.94));
        b.polygon(&upper);
        b.material(shell.shaded(0.6));
        b.polygon(&lower.iter().rev().copied().collect::<Vec<_>>());
        b.material(shell.shaded(0.8));
        for i in 0..peak.len() - 1 {
            b.polygon(&[lower[i], lower[i + 1], upper[i + 1], upper[i]]);
        }
        // Three ridges from front to back.
        b.material(shell.shaded(0.88));
        for (x, lift) in [(-0.06, 0.0), (0.0, 0.008), (0.06, 0.0)] {
            let reach = (0.19_f32 * 0.19 - x * x).sqrt();
            let ridge: Vec<[f32; 3]> = (0..=8)
                .map(|i| {
                    let angle = std::f32::consts::PI * (0.08 + 0.84 * i as f32 / 8.0);
                    let (y, z) = (-reach * angle.cos(), reach * angle.sin() * 1.1 + 0.033 + lift);
                    [x, y, z]
                })
                .collect();
            b.tube(&ridge, 0.012, 5);
        }
        b.material(DARK);
        b.turned_body(&[[0.0, 0.005], [0.176, 0.005]], 20);
    });
}

/// A stacking crate: posts, slats with dark gaps, a rim with a grip hole.
fn crate_of_slats(b: &mut MeshBuilder, plastic: Material) {
    let (w, d, h) = (0.25, 0.17, 0.28);
    b.material(plastic.shaded(0.28));
    b.block_without([-w + 0.02, -d + 0.02, 0.0], [w - 0.02, d - 0.02, h - 0.05], &[]);
    b.material(plastic);
    for (low, high) in [(0.0, 0.05), (0.075, 0.115), (0.14, 0.18)] {
        b.block_without([-w, -d, low], [w, d, high], &[]);
    }
    // The rim is four boards, so that the inside is visible.
    let (z0, z1, t) = (0.205, h, 0.022);
    b.block_without([-w, d - t, z0], [w, d, z1], &[]);
    b.block_without([-w, -d + t, z0], [-w + t, d - t, z1], &[]);
    b.block_without([w - t, -d + t, z0], [w, d - t, z1], &[]);
    b.block_without([-w, -d, z0], [w, -d + t, z1], &[]);
    b.material(plastic.shaded(0.82));
    for x in [-w - 0.004, -0.085, 0.055, w - 0.026] {
        b.block_without([x, -d - 0.006, 0.0], [x + 0.03, -d, h - 0.012], &[]);
    }
    b.material(plastic.shaded(0.2));
    b.block_without([-0.05, -d - 0.003, 0.225], [0.05, -d, 0.258], &[]);
}

/// A flat fuel can: pressed cross on the front, three carrying bars, spout on the right.
fn jerrycan(b: &mut MeshBuilder, paint: Material) {
    let (w, d, h) = (0.17, 0.085, 0.37);
    b.material(paint);
    b.bevelled([-w, -d, 0.0], [w, d, h], 0.025);
    // The seam around and the pressed cross.
    let groove =
        if paint.rgb.iter().all(|&c| c < 60) { paint.shaded(2.1) } else { paint.shaded(0.62) };
    b.material(groove);
    for (from, to) in [([-0.12, 0.06], [0.12, 0.3]), ([-0.12, 0.3], [0.12, 0.06])] {
        let (dx, dz) = (to[0] - from[0], to[1] - from[1]);
        let length = f32::hypot(dx, dz);
        let (nx, nz) = (-dz / length * 0.012, dx / length * 0.012);
        // The second bar is slightly raised, so that the two never share a plane.
        let y = -d - if dz > 0.0 { 0.006 } else { 0.009 };
        b.prism(
            &[
                [from[0] - nx, from[1] - nz],
                [to[0] - nx, to[1] - nz],
                [to[0] + nx, to[1] + nz],
                [from[0] + nx, from[1] + nz],
            ],
            y,
            -d + 0.001,
        );
    }
    b.material(paint.shaded(0.85));
    for y in [-0.05, 0.0, 0.05] {
        b.tube(
            &[[-0.12, y, h - 0.01], [-0.11, y, h + 0.05], [0.03, y, h + 0.05], [0.04, y, h - 0.01]],
            0.013,
            6,
        );
    }
    b.moved([0.115, 0.0, h - 0.015], |b| {
        b.turned(Vector3::y_axis(), 28.0, |b| {
            b.material(paint.shaded(0.75));
            b.turned_body(&[[0.036, 0.0], [0.036, 0.045]], 10);
            b.material(STEEL);
            b.turned_body(&[[0.044, 0.045], [0.044, 0.075], [0.0, 0.075]], 10);
            b.turned_body(&[[0.036, 0.045], [0.044, 0.045]], 10);
        });
    });
}

/// A gas bottle: foot ring, round shoulder, valve inside a collar with openings, a warning diamond.
fn gas_cylinder(b: &mut MeshBuilder, paint: Material) {
    b.material(paint.shaded(0.55));
    b.turned_body(&[[0.12, 0.0], [0.12, 0.03]], 18);
    b.material(paint);
    b.smooth_body(
        &[
            [0.125, 0.025],
            [0.145, 0.05],
            [0.145, 0.26],
            [0.14, 0.295],
            [0.115, 0.335],
            [0.07, 0.36],
            [0.03, 0.368],
        ],
        18,
    );
    // A weld seam around the middle.
    b.material(paint.shaded(0.8));
    b.turned_body(&[[0.145, 0.15], [0.149, 0.153], [0.149, 0.161], [0.145, 0.164]], 18);
    b.material(Material::glossy([190, 150, 70]));
    b.turned_body(&[[0.024, 0.36], [0.024, 0.41], [0.0, 0.41]], 8);
    b.material(BLACK);
    b.moved([0.0, 0.0, 0.405], |b| {
        b.turned_body(&[[0.0, 0.0], [0.042, 0.0], [0.042, 0.02], [0.0, 0.02]], 10)
    });
    // The collar: four posts and a ring.
    b.material(paint.shaded(0.9));
    for i in 0..4 {
        b.turned(Vector3::z_axis(), 45.0 + 90.0 * i as f32, |b| {
            b.block_without([0.078, -0.028, 0.335], [0.09, 0.028, 0.445], &[]);
        });
    }
    b.turned_body(
        &[
            [0.092, 0.44],
            [0.096, 0.445],
            [0.096, 0.475],
            [0.086, 0.475],
            [0.086, 0.44],
            [0.092, 0.44],
        ],
        18,
    );
    // A diamond on the front, with its dark border.
    for (half, y, material) in
        [(0.058, -0.1475, DARK), (0.046, -0.1495, Material::dull([250, 222, 60]))]
    {
        b.material(material);
        b.polygon(&[
            [0.0, y, 0.22 - half],
            [half, y, 0.22],
            [0.0, y, 0.22 + half],
            [-half, y, 0.22],
        ]);
    }
    b.material(DARK);
    b.polygon(&[[-0.014, -0.151, 0.2], [0.014, -0.151, 0.2], [0.0, -0.151, 0.245]]);
}

/// A wooden drum on its side, half turned to the viewer, wound with coloured cable.
fn cable_reel(b: &mut MeshBuilder, cable: Material) {
    let (flange, wound, half) = (0.215, 0.165, 0.11);
    b.moved([0.0, 0.0, flange], |b| {
        b.turned(Vector3::z_axis(), 52.0, |b| {
            b.turned(Vector3::x_axis(), 90.0, |b| {
                b.material(cable);
                let windings: Vec<[f32; 2]> = (0..=10)
                    .map(|i| {
                        [wound + if i % 2 == 0 { 0.0 } else { 0.016 }, -half + 0.022 * i as f32]
                    })
                    .collect();
                b.turned_body(&windings, 22);
                for (low, high) in [(-half - 0.028, -half), (half, half + 0.028)] {
                    b.material(WOOD.shaded(0.8));
                    b.turned_body(&[[flange, low], [flange, high]], 22);
                    b.material(WOOD);
                    b.turned_body(&[[0.0, low], [flange, low]], 22);
                    b.turned_body(&[[flange, high], [0.0, high]], 22);
                }
                // Hub, hole and bolts on the side that is seen.
                let face = half + 0.028;
                b.material(WOOD.shaded(0.62));
                b.turned_body(&[[0.085, face + 0.004], [0.0, face + 0.004]], 14);
                b.material(DARK);
                b.turned_body(&[[0.034, face + 0.008], [0.0, face + 0.008]], 10);
                b.material(STEEL);
                for i in 0..4 {
                    b.turned(Vector3::z_axis(), 90.0 * i as f32 + 20.0, |b| {
                        b.moved([0.062, 0.0, face + 0.005], |b| {
                            b.turned_body(&[[0.012, 0.0], [0.012, 0.01], [0.0, 0.01]], 6)
                        });
                    });
                }
                // Seams between the boards.
                b.material(WOOD.shaded(0.7));
                for y in [-0.13_f32, -0.045, 0.045, 0.13] {
                    let reach = (flange * flange - y * y).sqrt() * 0.98;
                    b.polygon(&[
                        [-reach, y - 0.004, face + 0.002],
                        [reach, y - 0.004, face + 0.002],
                        [reach, y + 0.004, face + 0.002],
                        [-reach, y + 0.004, face + 0.002],
                    ]);
                }
            });
        });
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_item_fits_its_bay_and_is_not_heavy() {
        for shape in Shape::ALL {
            for detail in Detail::ALL {
                let mesh = item(shape, [200, 40, 40], detail);
                let within = mesh.vertices.iter().all(|vertex| {
                    let p = vertex.position;
                    p.x.abs() <= 0.3 && p.y.abs() <= 0.26 && (-1e-4..=0.5).contains(&p.z)
                });
                assert!(within, "{shape:?} exceeds its bounds");
                let triangles = mesh.indices.len() / 3;
                let most = if detail == Detail::Near { 850 } else { 450 };
                assert!(triangles <= most, "{shape:?}, {detail:?}: {triangles} triangles");
            }
        }
    }

    #[test]
    fn no_item_has_the_colour_of_a_plate_frame() {
        let mesh_colours = Shape::ALL.into_iter().flat_map(|shape| {
            let mesh = item(shape, [34, 168, 163], Detail::Near);
            mesh.vertices.into_iter().map(|vertex| vertex.material.rgb)
        });
        for [r, g, b] in mesh_colours {
            assert!(!(r.min(b) >= 96 && g <= r.min(b) / 2), "{r}, {g}, {b} is near magenta");
        }
    }
}
