defmodule Aerie.Config.Keys do
  @moduledoc """
  The schema: every key of the configuration. The parts of the gateway declare them (`Aerie.Base.Settings`); the checks, the
  environment variables, `config/gateway.example.yaml` and `Aerie.Config.default/1` all come from there.
  """

  alias Aerie.Base.Settings
  alias Aerie.Base.Settings.Field

  @parts [
    MavRouter.Identity.Settings,
    MavRouter.Link.Settings,
    MavRouter.Client.Settings,
    MavRouter.Router.Settings,
    MavRouter.Signing.Settings,
    MavRouter.Recorder.Settings,
    Aerie.Vehicle.Settings,
    Aerie.Vehicle.State.Sampling.Settings,
    Aerie.Vehicle.Events.Journal.Settings,
    Aerie.Control.Commands.Settings,
    Aerie.Control.Policy.Store.Settings,
    Aerie.Control.Params.Cache.Settings,
    Aerie.Base.Log.Settings,
    Aerie.Api.Settings,
    Aerie.Node.Settings
  ]

  # The order of the example file.
  @order ~w(vehicle_id environment network mavlink links clients router vehicles signing recorder nats outbox remote tracks sampling events
            commands policy params shadow http console api websocket sockets shell serial timeouts limits log)a

  # Sections that belong to several parts.
  @docs %{
    "mavlink" => "The MAVLink side.",
    "timeouts" => "When silence means something.",
    "limits" => "What bounds memory when a radio (or somebody) makes vehicles up."
  }

  @doc "The parts with settings."
  @spec parts() :: [module()]
  def parts, do: @parts ++ Aerie.Fleet.Parts.settings()

  @doc "The top-level keys and sections, in the order of the example file."
  @spec order() :: [atom()]
  def order, do: @order

  @doc "All keys."
  @spec fields() :: [Field.t()]
  def fields do
    parts()
    |> Settings.fields(@docs)
    |> Enum.sort_by(fn field -> Enum.find_index(@order, &(&1 == field.key)) end)
  end
end
