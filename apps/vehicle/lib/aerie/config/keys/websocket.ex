defmodule Aerie.Config.Keys.Websocket do
  @moduledoc "MAVLink frames over WebSocket."

  import Aerie.Config.Field, only: [field: 4, section: 3]

  alias Aerie.Config.{Field, Types}

  @doc "The section `websocket`."
  @spec section() :: Field.t()
  def section do
    section(:websocket, "MAVLink frames over WebSocket, for ground stations in a browser.", [
      field(:enabled, :boolean, "Serve it.", default: true),
      field(:address, Types.ip(), "Address to listen on. Beyond loopback only with a key (api) and TLS.",
        default: "127.0.0.1"
      ),
      field(
        :port,
        {:integer, 0, 65_535},
        "Port. Taken: an error if given here, the next free one if not. 0: any free one.",
        default: 8765
      ),
      field(
        :sign,
        :boolean,
        "What clients with a key that may send do send unsigned is believed, and signed for vehicles that ask for it.",
        default: false
      ),
      field(:max_clients, {:integer, 1, 10_000}, "Clients at a time; further ones are refused.", default: 32),
      field(:cert_file, :path, "Certificate (PEM, with its chain); with it the server speaks wss only.",
        example: ~S("/etc/aerie/gateway.pem")
      ),
      field(:key_file, :path, "The certificate's private key (PEM).", example: ~S("/etc/aerie/gateway.key"))
    ])
  end
end
