"""Work in other processes: loading a scene (`scene_loader`, `scene_worker`) and training (`training_job`)."""
