defmodule Aerie.Config.Keys.Recorder do
  @moduledoc "What is recorded, where, and how much of it."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @save_on ~w(failsafe gcs_failsafe geofence battery.low battery.critical link.lost reboot collision mission.completed
              armed disarmed takeoff landed signing.rejected)a

  @doc "The section `recorder`."
  @spec section() :: Field.t()
  def section do
    section(:recorder, "Recordings (tlog files) of links and vehicles, without keys and signatures.", [
      field(:dir, :path, "Folder; made when the first recording begins.", default: "var/recordings"),
      field(
        :links,
        {:enum, [:off, :armed, :always]},
        "Record each link: armed means while a vehicle on it is armed.",
        default: :off
      ),
      field(
        :vehicles,
        {:enum, [:off, :armed, :always]},
        "Record each vehicle, by whatever links it is heard.",
        default: :off
      ),
      field(:sent, :boolean, "Record what is sent to vehicles as well.", default: true),
      field(:max_file_mb, {:number, 0.01, 4096}, "Size at which a recording goes on in a new file.",
        default: 64.0
      ),
      field(:max_file_minutes, {:number, 0.1, 10_080}, "Time after which it does.", default: 60.0),
      field(
        :max_mb,
        {:number, 0.1, 1_048_576},
        "Size of our recordings together; the oldest of ours go first.",
        default: 2048.0
      ),
      field(
        :min_free_mb,
        {:number, 0, 1_048_576},
        """
        What is to stay free on the disk: our oldest recordings are removed for it, and when that does not help nothing is
        recorded.
        """,
        default: 512.0
      ),
      field(
        :queue_kb,
        {:integer, 64, 1_048_576},
        "What may wait for the disk, for each recording; beyond it records are dropped and counted.",
        default: 4096
      ),
      field(
        :after_s,
        {:number, 0, 3600},
        "How long a recording goes on after disarming, or after the event that it is saved for.",
        default: 30.0
      ),
      field(
        :fsync,
        {:enum, [:always, :interval, :never]},
        "When data is forced to the disk: always (after each write), interval (once a second), never.",
        default: :interval
      ),
      section(
        :ring,
        "The last moments of each vehicle, in memory, saved when something happens or on request.",
        [
          field(:enabled, :boolean, "Keep them.", default: true),
          field(:seconds, {:number, 1, 3600}, "How far back, if max_kb is enough for it.", default: 120.0),
          field(:max_kb, {:integer, 16, 1_048_576}, "Memory for one vehicle.", default: 8192),
          field(
            :total_mb,
            {:number, 0.1, 65_536},
            "Memory for all vehicles; with many of them each has less.",
            default: 128.0
          ),
          field(:save_on, {:list, {:enum, @save_on}}, "Events on which the ring is saved; [] for none.",
            default: [:failsafe, :gcs_failsafe, :"battery.critical", :geofence]
          )
        ]
      )
    ])
  end
end
