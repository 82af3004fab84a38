defmodule Aerie.Fleet.Tracks.Settings do
  @moduledoc "The tracks: whether this gateway keeps where all vehicles were, and how much of it."
  use Aerie.Base.Settings

  part :identity, MavRouter.Identity.Settings

  section "tracks", "Where every vehicle was, for the console's replay and GET /api/tracks (docs/tracks.md)."

  setting :enabled,
          {:enum, [:auto, :on, :off]},
          "Whether tracks are kept. auto: yes, but not aboard a vehicle (vehicle_id), whose disk and CPU are small.",
          default: :auto

  setting :dir, :path, "Folder, for its owner only.", default: "var/tracks"

  setting :keep_h,
          {:integer, 1, 720},
          "Hours that are kept.",
          default: 24

  setting :max_bytes,
          {:integer, 1, 100_000},
          """
          The most that all files have together; then the oldest ones make room before their time, and the console
          says so. A day of a vehicle in the air takes about 1 MB, of one on the ground less than a tenth of that.
          """,
          key: "max_mb",
          default: 100,
          times: 1_048_576

  @doc "Whether tracks are kept."
  @spec on?(t()) :: boolean()
  def on?(%{enabled: :auto, identity: identity}), do: identity.vehicle_id == nil
  def on?(%{enabled: enabled}), do: enabled == :on
end
