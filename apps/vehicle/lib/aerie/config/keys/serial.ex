defmodule Aerie.Config.Keys.Serial do
  @moduledoc "Where serial links look for a vehicle."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field
  alias Aerie.Link.Serial.Detector

  @doc "The section `serial`."
  @spec section() :: Field.t()
  def section do
    section(
      :serial,
      "Where links with the url serial:auto and serial:DEVICE listen. Nothing is written while they do.",
      [
        field(
          :ports,
          {:list, :string},
          """
          Ports that are listened to before any others: names in /dev or paths. Those of the machine itself (ttyAMA0, ttyTHS1,
          ttyS0) are only listened to when they are named here; then /dev/serial/by-id/*, ttyACM* and ttyUSB* follow.
          """,
          default: [],
          example: "[/dev/ttyTHS1]"
        ),
        field(
          :bauds,
          {:list, {:integer, 50, 20_000_000}},
          "Baud rates that are tried, in this order; 20 at most.",
          default: Detector.bauds()
        )
      ]
    )
  end
end
