defmodule MavRouter.Recorder.Settings do
  @moduledoc "What is recorded, where, and how much of it; in bytes and milliseconds."
  use Aerie.Base.Settings

  import Aerie.Base.Settings.Rules

  @mega 1024 * 1024
  @save_on ~w(failsafe gcs_failsafe geofence battery.low battery.critical link.lost reboot collision mission.completed
              armed disarmed takeoff landed signing.rejected)a

  section "recorder", "Recordings (tlog files) of links and vehicles, without keys and signatures."

  setting :dir, :path, "Folder; made when the first recording begins.", default: "var/recordings"

  setting :links,
          {:enum, [:off, :armed, :always]},
          "Record each link: armed means while a vehicle on it is armed.",
          default: :off

  setting :vehicles,
          {:enum, [:off, :armed, :always]},
          "Record each vehicle, by whatever links it is heard.",
          default: :off

  setting :sent, :boolean, "Record what is sent to vehicles as well.", default: true

  setting :max_file, {:number, 0.01, 4096}, "Size at which a recording goes on in a new file.",
    key: "max_file_mb",
    default: 64.0,
    times: @mega

  setting :max_file_ms, {:number, 0.1, 10_080}, "Time after which it does.",
    key: "max_file_minutes",
    default: 60.0,
    times: 60_000

  setting :max_total,
          {:number, 0.1, 1_048_576},
          "Size of our recordings together; the oldest of ours go first.",
          key: "max_mb",
          default: 2048.0,
          times: @mega

  setting :min_free,
          {:number, 0, 1_048_576},
          """
          What is to stay free on the disk: our oldest recordings are removed for it, and when that does not help nothing is
          recorded.
          """,
          key: "min_free_mb",
          default: 512.0,
          times: @mega

  setting :queue,
          {:integer, 64, 1_048_576},
          "What may wait for the disk, for each recording; beyond it records are dropped and counted.",
          key: "queue_kb",
          default: 4096,
          times: 1024

  setting :after_ms,
          {:number, 0, 3600},
          "How long a recording goes on after disarming, or after the event that it is saved for.",
          key: "after_s",
          default: 30.0,
          times: 1000

  setting :fsync,
          {:enum, [:always, :interval, :never]},
          "When data is forced to the disk: always (after each write), interval (once a second), never.",
          default: :interval

  setting :flush_ms, {:integer, 1, 60_000}, "How long records are collected.", internal: true, default: 500
  setting :pause_ms, {:integer, 1, 60_000}, "Pause after a fault of the disk.", internal: true, default: 5000

  setting :space_ms, {:integer, 1, 60_000}, "Between two looks at the disk's free space.",
    internal: true,
    default: 10_000

  setting :files, :string, "The module that does what is done with files.",
    internal: true,
    default: MavRouter.Recorder.Files

  section "recorder.ring",
          "The last moments of each vehicle, in memory, saved when something happens or on request."

  setting :ring, :boolean, "Keep them.", key: "enabled", default: true

  setting :ring_ms, {:number, 1, 3600}, "How far back, if max_kb is enough for it.",
    key: "seconds",
    default: 120.0,
    times: 1000

  setting :ring_bytes, {:integer, 16, 1_048_576}, "Memory for one vehicle.",
    key: "max_kb",
    default: 8192,
    times: 1024

  setting :ring_total,
          {:number, 0.1, 65_536},
          "Memory for all vehicles; with many of them each has less.",
          key: "total_mb",
          default: 128.0,
          times: @mega

  setting :save_on, {:list, {:enum, @save_on}}, "Events on which the ring is saved; [] for none.",
    default: [:failsafe, :gcs_failsafe, :"battery.critical", :geofence]

  @doc "Event types come as text."
  @impl Aerie.Base.Settings
  def derive(settings), do: %{settings | save_on: Enum.map(settings.save_on, &to_string/1)}

  @impl Aerie.Base.Settings
  def problems(%{recorder: %{max_file_mb: file, max_mb: all}}),
    do: failed([{file > all, ["recorder", "max_file_mb"], "at most recorder.max_mb (#{all})", "#{file}"}])
end
