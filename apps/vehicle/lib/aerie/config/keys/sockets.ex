defmodule Aerie.Config.Keys.Sockets do
  @moduledoc "Unix sockets for programs on this machine."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.Field

  @doc "The section `sockets`."
  @spec section() :: Field.t()
  def section do
    section(
      :sockets,
      "Unix sockets for programs on this machine: state.sock (JSON lines) and mavlink.sock (frames).",
      [
        field(:enabled, :boolean, "Open them.", default: true),
        field(
          :dir,
          :path,
          "Folder. Left out: $XDG_RUNTIME_DIR/aerie, /run/aerie, or var/run. Who may use them is what its permissions say.",
          example: ~S("/run/aerie")
        ),
        field(:state_hz, {:number, 0.1, 50}, "How often state.sock tells every vehicle's state.",
          default: 10.0
        ),
        field(
          :sign,
          :boolean,
          "What comes by mavlink.sock unsigned is believed, and signed for vehicles that ask for it.",
          default: false
        ),
        field(:max_clients, {:integer, 1, 10_000}, "Clients of each socket; further ones are refused.",
          default: 32
        )
      ]
    )
  end
end
