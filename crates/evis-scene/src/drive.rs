//! Leaving nodes to a host.

use std::sync::Arc;

use crate::error::SceneError;
use crate::host_poses::HostPoses;
use crate::model::{Scene, Variant};
use crate::motion::Motion;
use crate::pose::SceneState;
use crate::track::Track;

impl Scene {
    /// Leaves the motion of the nodes `names` to a host from scene time `start_us` on: names of nodes or of cameras, whose
    /// poses in the world then come through [`HostPoses::advance`]. Until the first one they are where the scene has them at
    /// `start_us`.
    ///
    /// # Errors
    /// Names that do not exist, or that several nodes have.
    pub fn drive(&mut self, names: &[String], start_us: i64) -> Result<Arc<HostPoses>, SceneError> {
        let mut nodes = Vec::with_capacity(names.len());
        for name in names {
            let node = self.driven_node(name)?;
            if nodes.contains(&node) {
                return Err(SceneError::Rule(format!(
                    "'{name}' is named twice among the nodes that a host moves"
                )));
            }
            nodes.push(node);
        }
        if self.variants.is_empty() {
            self.variants.push(Variant::default());
        }
        let mut tracks = Vec::with_capacity(self.variants.len());
        for environment in 0..self.variants.len() {
            let mut state = SceneState::default();
            self.evaluate_variant(self.variants.get(environment), start_us as f64 * 1e-6, &mut state);
            let own = nodes.iter().map(|&node| Arc::new(Track::new(start_us, &state.world_from_node[node])));
            tracks.push(own.collect::<Vec<_>>());
        }
        for (variant, tracks) in self.variants.iter_mut().zip(&tracks) {
            variant.poses = nodes.iter().copied().zip(tracks.iter().cloned()).collect();
        }
        for (&node, track) in nodes.iter().zip(&tracks[0]) {
            self.nodes[node].motion = Motion::Driven(Arc::clone(track));
        }
        let host = Arc::new(HostPoses::new(names.to_vec(), tracks, start_us));
        self.host_poses = Some(Arc::clone(&host));
        Ok(host)
    }

    fn driven_node(&self, name: &str) -> Result<usize, SceneError> {
        let mut found = (0..self.nodes.len()).filter(|&i| self.nodes[i].name == name);
        match (found.next(), found.next()) {
            (Some(node), None) => Ok(node),
            (Some(_), Some(_)) => Err(SceneError::Rule(format!(
                "several nodes are named '{name}'; give each that a host moves a name of its own"
            ))),
            _ => match self.cameras.iter().find(|camera| camera.name == name) {
                Some(camera) => Ok(camera.node),
                None => Err(SceneError::Unknown {
                    what: "node or camera",
                    name: name.into(),
                    known: self.nodes.iter().map(|n| n.name.clone()).filter(|n| !n.is_empty()).collect(),
                }),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, DVec3};

    use super::*;
    use crate::builtin;
    use crate::track::HostPose;

    fn at(t_us: i64, x: f64) -> HostPose {
        HostPose { t_us, position: DVec3::new(x, 0.0, 0.0), rotation: DQuat::IDENTITY, velocity: None }
    }

    #[test]
    fn a_driven_node_is_where_the_host_says_and_others_are_not() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some() && n.parent.is_none()).unwrap();
        let (name, other) = (scene.nodes[node].name.clone(), scene.clone());
        let host = scene.drive(std::slice::from_ref(&name), 0).unwrap();
        let state = |scene: &Scene, t_s| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.first(), t_s, &mut state);
            state.world_from_node
        };
        assert_eq!(host.known_until_us(), 0);
        let rest = state(&scene, 0.0)[node];
        assert!((rest.w_axis - state(&other, 0.0)[node].w_axis).length() < 1e-12, "it begins where it was");
        host.advance(&[(0, 0, vec![at(10_000, 7.0)])], 10_000).unwrap();
        assert_eq!(host.known_until_us(), 10_000);
        assert_eq!(state(&scene, 0.01)[node].w_axis.x, 7.0);
        // A step without a pose: it rests where it is, and leaves from there.
        host.advance(&[], 20_000).unwrap();
        host.advance(&[(0, 0, vec![at(30_000, 9.0)])], 30_000).unwrap();
        assert_eq!(state(&scene, 0.02)[node].w_axis.x, 7.0);
        assert!((state(&scene, 0.025)[node].w_axis.x - 8.0).abs() < 1e-12);
        host.forget_before(25_000);
        assert!((state(&scene, 0.025)[node].w_axis.x - 8.0).abs() < 1e-12);
        for (i, (a, b)) in state(&scene, 0.02).iter().zip(&state(&other, 0.02)).enumerate() {
            assert!(i == node || scene.nodes[i].parent == Some(node) || a == b, "node {i}");
        }
    }

    #[test]
    fn a_node_that_jumps_was_never_elsewhere() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let node = scene.nodes.iter().position(|n| n.mesh.is_some() && n.parent.is_none()).unwrap();
        let host = scene.drive(&[scene.nodes[node].name.clone()], 0).unwrap();
        let x = |t_s| {
            let mut state = SceneState::default();
            scene.evaluate_variant(scene.variants.first(), t_s, &mut state);
            state.world_from_node[node].w_axis.x
        };
        host.advance(&[(0, 0, vec![at(10_000, 1.0)])], 10_000).unwrap();
        assert!(host.jump(&[(0, 0, at(0, f64::NAN))]).unwrap_err().to_string().contains("not finite"));
        assert!(host.jump(&[(1, 0, at(0, 0.0))]).is_err());
        assert_eq!(x(0.01), 1.0);
        host.jump(&[(0, 0, at(0, 5.0))]).unwrap();
        assert_eq!((x(0.005), x(0.01)), (5.0, 5.0));
        // It goes on from there.
        host.advance(&[(0, 0, vec![at(20_000, 6.0)])], 20_000).unwrap();
        assert!((x(0.015) - 5.5).abs() < 1e-12);
    }

    #[test]
    fn poses_that_cannot_be_are_refused_and_change_nothing() {
        let mut scene = builtin::load("desk", 0).unwrap();
        let name = scene.nodes.iter().find(|n| n.mesh.is_some()).unwrap().name.clone();
        let host = scene.drive(std::slice::from_ref(&name), 0).unwrap();
        host.advance(&[(0, 0, vec![at(10_000, 1.0)])], 10_000).unwrap();
        let bad = [
            (vec![at(10_000, 1.0)], "known until 10000 us"),
            (vec![at(15_000, 1.0)], "the step ends at 20000 us"),
            (vec![at(18_000, 1.0), at(17_000, 1.0)], "in order"),
            (vec![at(20_000, f64::NAN)], "not finite"),
            (
                vec![HostPose { rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..at(20_000, 1.0) }],
                "unit quaternion",
            ),
        ];
        for (poses, message) in bad {
            let error = host.advance(&[(0, 0, poses)], 20_000).unwrap_err().to_string();
            assert!(error.contains(message) && error.contains(&name), "{error}");
            assert_eq!(host.known_until_us(), 10_000);
        }
        let twice = [(0, 0, vec![at(20_000, 1.0)]), (0, 0, vec![at(20_000, 2.0)])];
        assert!(host.advance(&twice, 20_000).unwrap_err().to_string().contains("twice"));
        for (environment, node) in [(1, 0), (0, 1)] {
            let error = host.advance(&[(environment, node, vec![at(20_000, 1.0)])], 20_000).unwrap_err();
            assert!(error.to_string().contains("1 node(s) in 1 environment(s)"), "{error}");
        }
        assert!(scene.drive(&["nobody".into()], 0).unwrap_err().to_string().contains("nobody"));
        assert!(scene.drive(&[name.clone(), name], 0).unwrap_err().to_string().contains("twice"));
    }
}
