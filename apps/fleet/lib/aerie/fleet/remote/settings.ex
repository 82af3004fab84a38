defmodule Aerie.Fleet.Remote.Settings do
  @moduledoc "Vehicles that other gateways hear: whether this one shows and commands them, and how it announces its own."
  use Aerie.Base.Settings

  part :bridge, Aerie.Fleet.Bridge.Settings

  section "remote", "Vehicles that are reached over NATS, through another gateway (docs/fleet.md)."

  setting :enabled,
          :boolean,
          """
          Whether this gateway shows and commands the vehicles of the other gateways of its environment: for a hub. A companion
          leaves it off, because it would get the state of the whole fleet over its radio.
          """,
          default: false

  setting :max_vehicles,
          {:integer, 1, 100_000},
          "Remote vehicles that are kept. A further one takes the place of a lost one, or is not shown.",
          default: 2_000

  setting :lost_us,
          {:number, 1, 3600},
          """
          A remote vehicle of which NATS has brought nothing for this long is lost, and stale after half of it. A command to a
          lost one is refused at once.
          """,
          key: "lost_s",
          default: 10.0,
          times: 1_000_000

  setting :announce_ms,
          {:number, 0.2, 600},
          "How often this gateway tells the others which vehicles it hears.",
          key: "announce_s",
          default: 2.0,
          times: 1000

  setting :nkey_seed_file,
          :file,
          """
          File with the nkey seed (SU…) by which this gateway signs the commands that it passes on; their policy.sources list its
          public part. Left out: they are not signed, so the other gateway needs policy.unsigned.
          """,
          example: ~S("/etc/gateway/hub.nk")
end
