defmodule Aerie.Config.Keys do
  @moduledoc """
  The schema: every key of the configuration, with type, limits, default and meaning. The checks, the environment
  variables, `config/gateway.example.yaml` and `Aerie.Config.default/1` all come from here and from nowhere else.

  Each section has a module below this one; the order here is the order of the example file.
  """

  import Aerie.Config.Field, only: [field: 4]

  alias Aerie.Config.{Field, Types}
  alias Aerie.Config.Keys.{Api, Clients, Events, Http, Limits, Links, Mavlink, Nats, Outbox, Policy, Recorder}
  alias Aerie.Config.Keys.{Router, Sampling, Serial, Signing, Sockets, Timeouts, Vehicles, Websocket}

  @doc "The names of the state groups."
  @spec groups() :: [atom()]
  defdelegate groups, to: Sampling

  @doc "All keys."
  @spec fields() :: [Field.t()]
  def fields do
    names() ++
      [
        Mavlink.section(),
        Links.field(),
        Clients.field(),
        Router.section(),
        Vehicles.field(),
        Signing.section(),
        Recorder.section(),
        Nats.section(),
        Outbox.section(),
        Sampling.section(),
        Events.section(),
        Policy.section(),
        Http.section(),
        Api.section(),
        Websocket.section(),
        Sockets.section(),
        Serial.section(),
        Timeouts.section(),
        Limits.section()
      ]
  end

  defp names do
    [
      field(
        :vehicle_id,
        Types.token(),
        """
        Companion: the public name of the one vehicle aboard which this gateway runs; it is the vehicle with system id
        mavlink.system_id on the default network. Hub: leave it out and name vehicles under vehicles.
        """,
        example: "VID-001"
      ),
      field(:environment, Types.token(), "Second word of every NATS subject: fleet.{environment}.{vehicle}.…",
        default: "dev"
      ),
      field(:network, Types.token(), "The network of links and vehicles that name none.", default: "main")
    ]
  end
end
