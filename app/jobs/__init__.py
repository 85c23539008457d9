"""Work outside the window's thread: loading a scene (`scene_loader`, `scene_worker`), training (`training_job`), saving
films (`film`), exports, and readers that run in threads of their own."""
