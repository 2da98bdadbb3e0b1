//! The agent's camera (specification, section 2) as matrices.
//!
//! Three spaces: world (x east, y north, z up), camera (x right, y up, z ahead) and clip.

use domain::camera::CameraSetup;
use domain::{Heading, Pose};
use nalgebra::{Matrix4, Point3, Vector3};
use raster::NEAR_M;

/// A camera in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Camera {
    pub(super) position: Point3<f32>,
    /// Unit vectors to the right of the image and along the optical axis. Both are horizontal.
    pub(super) right: Vector3<f32>,
    pub(super) ahead: Vector3<f32>,
    /// Tangents of half the horizontal and of half the vertical field of view.
    pub(super) half_extent: [f32; 2],
}

impl Camera {
    /// The agent's camera at `pose`, for images of this width and height with square pixels.
    pub(super) fn new(setup: CameraSetup, pose: Pose, [width_px, height_px]: [u32; 2]) -> Self {
        let (x, y) = pose.cell.centre();
        let vector = |heading: Heading| {
            let (x, y) = heading.vector();
            Vector3::new(f32::from(x), f32::from(y), 0.0)
        };
        let across = f32::from(setup.half_width_percent) / 100.0;
        let height_m = f32::from(setup.height_cm) / 100.0;
        Self {
            position: Point3::new(x, y, height_m),
            right: vector(pose.heading.right()),
            ahead: vector(pose.heading),
            half_extent: [across, across * height_px as f32 / width_px as f32],
        }
    }

    /// The rigid transform from world to camera space.
    pub(super) fn camera_from_world(&self) -> Matrix4<f32> {
        let rows = [self.right, Vector3::z(), self.ahead];
        let mut matrix = Matrix4::identity();
        for (i, row) in rows.into_iter().enumerate() {
            matrix.fixed_view_mut::<1, 3>(i, 0).copy_from(&row.transpose());
            matrix[(i, 3)] = -row.dot(&self.position.coords);
        }
        matrix
    }

    /// The perspective projection with reversed depth: 1 at the near plane, 0 infinitely far away.
    pub(super) fn clip_from_camera(&self) -> Matrix4<f32> {
        let [across, up] = self.half_extent;
        Matrix4::new(
            1.0 / across,
            0.0,
            0.0,
            0.0, //
            0.0,
            1.0 / up,
            0.0,
            0.0, //
            0.0,
            0.0,
            0.0,
            NEAR_M, //
            0.0,
            0.0,
            1.0,
            0.0,
        )
    }

    /// The transform from world to clip space.
    pub(super) fn clip_from_world(&self) -> Matrix4<f32> {
        self.clip_from_camera() * self.camera_from_world()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The position, from the top left corner of a 448 x 448 image, of a point in the world.
    fn pixel(pose: &str, world: [f32; 3]) -> (f32, f32) {
        pixel_of(CameraSetup::STANDARD, pose, world)
    }

    fn pixel_of(setup: CameraSetup, pose: &str, world: [f32; 3]) -> (f32, f32) {
        let camera = Camera::new(setup, pose.parse().unwrap(), [448, 448]);
        let clip = camera.clip_from_world() * Point3::from(world).to_homogeneous();
        (224.0 * (1.0 + clip.x / clip.w), 224.0 * (1.0 - clip.y / clip.w))
    }

    #[test]
    fn points_project_to_the_specified_pixels() {
        // 2 m ahead, 1 m to the right and 0.5 m up: focal * right / ahead from the centre.
        for (pose, world) in [
            ("3,12,N", [4.5, 14.5, 1.7]),
            ("3,12,E", [5.5, 11.5, 1.7]),
            ("3,12,S", [2.5, 10.5, 1.7]),
            ("3,12,W", [1.5, 13.5, 1.7]),
        ] {
            let (x, y) = pixel(pose, world);
            assert!((x - 336.0).abs() < 1e-3 && (y - 168.0).abs() < 1e-3, "{pose}: {x}, {y}");
        }
    }

    #[test]
    fn other_cameras_are_higher_and_narrower() {
        let world = [4.5, 14.5, 1.7];
        let high = CameraSetup { height_cm: 170, ..CameraSetup::STANDARD };
        let narrow = CameraSetup { half_width_percent: 50, ..CameraSetup::STANDARD };
        for (setup, expected) in [(high, (336.0, 224.0)), (narrow, (448.0, 112.0))] {
            let (x, y) = pixel_of(setup, "3,12,N", world);
            assert!((x - expected.0).abs() < 1e-3 && (y - expected.1).abs() < 1e-3, "{x}, {y}");
        }
    }

    #[test]
    fn depth_falls_from_one_to_zero() {
        let camera = Camera::new(CameraSetup::STANDARD, Pose::new(0, 0, Heading::N), [448, 448]);
        let depth = |ahead: f32| {
            let clip = camera.clip_from_camera() * nalgebra::Vector4::new(0.0, 0.0, ahead, 1.0);
            clip.z / clip.w
        };
        assert!((depth(NEAR_M) - 1.0).abs() < 1e-6);
        assert!(depth(1.0) > depth(10.0) && depth(10.0) > 0.0);
    }
}
