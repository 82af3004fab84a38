defmodule Aerie.Fleet.Operations.Schema do
  @moduledoc "JSON Schemas of operations on many vehicles; the first is as strict as `Aerie.Fleet.Operations.Request`. Pure."

  import Aerie.Base.JsonSchema

  alias Aerie.Fleet.Operations.Request
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command

  @type t :: Aerie.Base.JsonSchema.t()

  @doc "The request that begins one. `id?`: it must have an id, as over NATS."
  @spec request(id? :: boolean()) :: t()
  def request(id?) do
    common = %{
      id: described(id(), "the same id is the same operation"),
      step: Map.put(integer(1, 100), :default, 20),
      pause_s: Map.put(number(0, 3_600), :default, 0),
      halt_ratio: Map.put(number(0, 1), :default, 1)
    }

    vehicles = %{type: :array, minItems: 1, maxItems: Request.max_vehicles(), items: token()}
    tag = described(text(64), "all vehicles that have it when the operation begins")
    await = %{enum: ~w(written converged), default: :written}

    what = [
      command: %{command: ref("command_of_operation"), timeout_s: number(1, 300)},
      shadow: %{shadow: ref("change_of_operation"), await: await, timeout_s: number(1, 3_600)}
    ]

    required = if id?, do: [:id], else: []

    kinds =
      for {kind, properties} <- what, {target, schema} <- [vehicles: vehicles, tag: tag] do
        common |> Map.merge(properties) |> Map.put(target, schema) |> object([kind, target | required])
      end

    %{oneOf: kinds}
  end

  @doc "The schemas that the request refers to, by their names."
  @spec shared() :: %{String.t() => t()}
  def shared do
    commands =
      for type <- Command.Types.all() do
        schema = Command.Schema.envelope(type, type?: true)
        %{schema | properties: Map.take(schema.properties, [:type, :params])}
      end

    change = Shadow.Schema.update(false)

    %{
      "command_of_operation" => %{oneOf: commands},
      "change_of_operation" => %{change | properties: Map.delete(change.properties, :version)}
    }
  end

  @doc "The request that names one."
  @spec named() :: t()
  def named, do: object(%{id: id()}, [:id], open: true)

  defp id, do: %{type: :string, pattern: "^[A-Za-z0-9_-]{1,32}$"}

  @doc "An operation as answers have it. `vehicles?`: with what became of each vehicle."
  @spec operation(vehicles? :: boolean()) :: t()
  def operation(vehicles?) do
    count = %{type: :integer, minimum: 0}

    vehicle =
      object(
        %{state: %{enum: ~w(waiting under_way ok failed)}, result: %{}, reason: %{type: [:string, :null]}},
        [:state],
        open: true
      )

    properties = %{
      id: id(),
      state: %{enum: ~w(running done halted stopped interrupted)},
      source: described(%{type: :string}, "who began it"),
      begun_at: %{type: :string, format: :"date-time"},
      done_at: %{type: [:string, :null], format: :"date-time"},
      what: described(%{type: :object}, "its command, or its change of the desired state"),
      step: %{type: :integer, minimum: 1},
      counts: object(Map.new(~w(waiting under_way ok failed)a, &{&1, count}), [], open: true)
    }

    required = Map.keys(properties)
    vehicles = if vehicles?, do: %{vehicles: %{type: :object, additionalProperties: vehicle}}, else: %{}
    object(Map.merge(properties, vehicles), required ++ Map.keys(vehicles), open: true)
  end
end
