//! Paints blocks on the ground.

use super::camera::Camera;
use super::ground::{Ground, Shadow};
use super::image::{Image, WHITE};
use super::model::Block;
use super::raster::Samples;
use super::texture;

/// Draws pictures one after another; reuses memory, and the ground while camera and ground stay the same.
#[derive(Debug, Default)]
pub struct Painter {
    samples: Samples,
    shadow: Shadow,
    /// The last picture without blocks.
    backdrop: Option<(Camera, Ground, Image)>,
}

impl Painter {
    /// Draws the blocks on a white background from the camera's view. Equal arguments give equal images.
    pub fn paint(&mut self, blocks: &[Block], camera: &Camera, ground: Ground) -> Image {
        let mut image = self.empty_scene(camera, ground);
        self.shadow.draw(camera, blocks, &mut image);
        self.samples.clear(camera.size_px());
        // Draw the nearest first, so that fewer hidden samples are shaded.
        let mut in_order: Vec<&Block> = blocks.iter().collect();
        in_order.sort_by(|a, b| camera.nearness(&b.pose).total_cmp(&camera.nearness(&a.pose)));
        for block in in_order {
            for side in block.sides() {
                texture::draw(&mut self.samples, camera, block, &side);
            }
        }
        self.samples.resolve(&mut image);
        image
    }

    fn empty_scene(&mut self, camera: &Camera, ground: Ground) -> Image {
        match &self.backdrop {
            Some((known, on, image)) if (known, on) == (camera, &ground) => image.clone(),
            _ => {
                let [width, height] = camera.size_px();
                let mut image = Image::filled(width, height, WHITE);
                ground.draw(camera, &mut image);
                self.backdrop = Some((camera.clone(), ground, image.clone()));
                image
            }
        }
    }
}
