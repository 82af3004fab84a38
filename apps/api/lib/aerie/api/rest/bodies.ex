defmodule Aerie.Api.Rest.Bodies do
  @moduledoc """
  The schemas of the bodies of `/api` by the names that routes have: as strict as what reads them, but for the content
  of connection strings, plans and files of parameters. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Log
  alias Aerie.Fleet.{Operations, Shadow}
  alias Aerie.Vehicle.Command
  alias MavRouter.Endpoints.RulesSchema

  @modes ~w(always armed off)
  # How connection strings begin; what follows is in docs/hub.md and docs/clients.md.
  @link "^((udp|udpin|udpout|udpbcast|tcp|tcpin|serial|msp):|wss?://|/|tty|cu\\.|rfcomm|COM)[!-~]*$"
  @client "^((udp|udpin|udpout|udpbcast|tcp|tcpin):|wss?://)[!-~]*$"

  @doc "All of them."
  @spec all() :: %{(atom() | String.t()) => map()}
  def all do
    own = %{
      object: %{type: :object},
      nothing: object(%{}),
      mode: object(%{mode: %{enum: @modes}}, [:mode], open: true),
      save: object(%{reason: text(40, 0)}, [], open: true),
      link: link(),
      client: client(),
      rules: RulesSchema.change(),
      log: log(),
      signing: signing(),
      command: %{oneOf: for(type <- Command.Types.all(), do: Command.Schema.envelope(type, type?: true))},
      result: Command.Schema.result(),
      under_way:
        object(%{id: token(), vehicle: token(), state: %{const: "under_way"}}, [:id, :vehicle, :state])
    }

    own
    |> Map.merge(Aerie.Api.Rest.Operations.schemas())
    |> Map.merge(Command.Schema.shared())
    |> Map.merge(Operations.Schema.shared())
    |> Map.merge(Shadow.Schema.shared())
    |> Map.put("reported", Shadow.Schema.reported())
  end

  defp url(pattern), do: %{type: :string, maxLength: 512, pattern: pattern, examples: ["udpin:0.0.0.0:14550"]}

  defp link do
    token = nullable(token())
    label = nullable(text(256, 0))
    properties = %{url: url(@link), id: token, network: token, group: token, label: label}
    object(Map.put(properties, :high_latency, %{type: [:boolean, :null]}), [:url])
  end

  defp client do
    name = %{type: :string, pattern: "^[A-Za-z0-9_.-]{1,64}$"}
    networks = nullable(%{type: :array, minItems: 1, maxItems: 16, items: token()})
    access = nullable(%{enum: ~w(full read)})
    object(%{url: url(@client), id: nullable(name), networks: networks, access: access}, [:url])
  end

  defp log do
    level = %{enum: Log.level_names()}
    areas = Map.new(Log.areas(), &{&1, nullable(level)})
    object(%{level: level, areas: object(areas)}, [], minProperties: 1)
  end

  defp signing do
    common = %{link: nullable(%{type: :string, maxLength: 128}), component: nullable(integer(1, 255))}
    enrol = %{action: %{const: "enrol"}, key: %{enum: ~w(configured generate previous)}}
    other = %{action: %{enum: ~w(revoke discard)}, key: %{const: "configured"}}
    %{oneOf: for(one <- [enrol, other], do: common |> Map.merge(one) |> object([:action]))}
  end
end
