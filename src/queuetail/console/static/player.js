// Plays a finished run: the moment asked for moves with the clock while it plays.
export class Player {
  constructor(about) {
    this.about = about;
    this.t_s = about.start_s;
    this.playing = false;
    this.seekers = [];
    this.slider = document.getElementById("qt-time");
    this.button = document.getElementById("qt-play");
    this.clock = document.getElementById("qt-clock");
    this.rate = document.getElementById("qt-rate");
    Object.assign(this.slider, { min: about.start_s, max: about.end_s, value: this.t_s });
    const asked = Number(new URLSearchParams(location.search).get("t"));
    if (Number.isFinite(asked) && asked > 0) this.move(Math.min(asked, about.end_s));
    this.slider.addEventListener("input", () => this.seek(Number(this.slider.value)));
    this.button.addEventListener("click", () => this.toggle());
    this.show();
  }

  onSeek(call) { this.seekers.push(call); }

  seek(t_s) {
    this.move(t_s);
    this.seekers.forEach((call) => call());
  }

  move(t_s) {
    this.t_s = t_s;
    this.since = performance.now();
    this.show();
  }

  toggle() {
    this.playing = !this.playing;
    if (this.playing && this.t_s >= this.about.end_s) this.t_s = this.about.start_s;
    this.since = performance.now();
    this.button.textContent = this.playing ? "❚❚" : "▶";
    this.button.setAttribute("aria-label", this.playing ? "Pause" : "Play");
    this.seek(this.t_s);
  }

  // After a picture: go on by the time that has passed, and ask for the next.
  drawn(ask) {
    if (!this.playing) {
      if (this.shown_s !== this.t_s) { this.shown_s = this.t_s; setTimeout(ask, 30); }
      return;
    }
    setTimeout(() => {
      const now = performance.now();
      const t_s = this.t_s + (Number(this.rate.value) * (now - this.since)) / 1000;
      this.move(Math.min(t_s, this.about.end_s));
      if (this.t_s >= this.about.end_s) this.toggle(); else ask();
    }, 30);
  }

  show() {
    this.slider.value = this.t_s;
    const minutes = Math.floor(this.t_s / 60), seconds = (this.t_s % 60).toFixed(1).padStart(4, "0");
    this.clock.textContent = `${minutes}:${seconds}`;
    this.slider.setAttribute("aria-valuetext", `${minutes} min ${seconds} s`);
  }
}
