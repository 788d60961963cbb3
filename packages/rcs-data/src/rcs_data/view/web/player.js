// Keeps the videos of one or two episodes at the same frame, paused or playing.
"use strict";

class Player {
  // `onFrame` is called with every frame that is reached, `onPlaying` when playing starts or stops.
  constructor(onFrame, onPlaying) {
    this.onFrame = onFrame;
    this.onPlaying = onPlaying;
    this.videos = [];
    this.frame = 0;
    this.rows = 1;
    this.fps = 1;
    this.speed = 1;
    this.isPlaying = false;
    this.tick = this.tick.bind(this);
  }

  // Take the videos, each with the number of its frames in `rows`, and stop. The longest episode's come first.
  load(videos, rows, fps) {
    this.pause();
    for (const { video } of this.videos) { video.removeAttribute("src"); video.load(); }
    this.videos = [...videos].sort((a, b) => b.rows - a.rows);
    this.rows = rows;
    this.fps = fps;
    for (const { video } of this.videos) {
      video.addEventListener("loadeddata", () => this.show(video));
      // While one is still looking for a frame, newer wishes wait, so dragging does not queue up.
      video.addEventListener("seeked", () => { if (!this.isPlaying) this.show(video); });
    }
  }

  // Go to a frame.
  seek(frame) {
    this.frame = Math.max(0, Math.min(this.rows - 1, Math.round(frame) || 0));
    this.since = { frame: this.frame, time: performance.now() };
    for (const { video } of this.videos) this.show(video, this.isPlaying);
    this.onFrame(this.frame);
  }

  // Bring one video to the current frame, or to its last one if it is shorter.
  show(video, now = false) {
    const rows = this.videos.find((one) => one.video === video)?.rows;
    if (!rows || video.readyState < 1 || (video.seeking && !now)) return;
    const time = (Math.min(this.frame, rows - 1) + 0.5) / this.fps; // in its middle, so that rounding does not matter
    if (Math.abs(video.currentTime - time) > 0.4 / this.fps) video.currentTime = time;
  }

  play() {
    if (this.frame >= this.rows - 1) this.seek(0);
    this.isPlaying = true;
    this.since = { frame: this.frame, time: performance.now() };
    for (const { video, rows } of this.videos) if (this.frame < rows - 1) this.start(video);
    this.onPlaying(true);
    requestAnimationFrame(this.tick);
  }

  start(video) {
    video.playbackRate = this.speed;
    video.play().catch(() => {}); // one that cannot play says so by its own error
  }

  pause() {
    this.isPlaying = false;
    for (const { video } of this.videos) video.pause();
    this.onPlaying(false);
    this.seek(this.frame);
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
  }

  setSpeed(speed) {
    this.speed = speed;
    this.since = { frame: this.frame, time: performance.now() };
    for (const { video } of this.videos) video.playbackRate = speed;
  }

  // One refresh of the display: the first video that plays is the clock, or the computer's where there is none.
  tick() {
    if (!this.isPlaying) return;
    const lead = this.videos.find(({ video }) => video.readyState >= 2 && !video.error)?.video;
    const elapsed = ((performance.now() - this.since.time) / 1000) * this.speed * this.fps;
    const frame = Math.floor(lead ? lead.currentTime * this.fps + 1e-3 : this.since.frame + elapsed);
    if (frame !== this.frame) {
      this.frame = Math.max(0, Math.min(this.rows - 1, frame));
      this.onFrame(this.frame);
      this.align(lead);
    }
    if (this.frame >= this.rows - 1) this.pause();
    else requestAnimationFrame(this.tick);
  }

  // Pull videos along that are more than two frames away from the one that is the clock.
  align(lead) {
    for (const { video, rows } of this.videos) {
      if (video === lead || this.frame >= rows - 1 || video.readyState < 2) continue;
      if (video.paused && !video.seeking) this.start(video);
      if (!video.seeking && Math.abs(video.currentTime - lead.currentTime) > (2 * Math.max(1, this.speed)) / this.fps) {
        video.currentTime = lead.currentTime;
      }
    }
  }
}
