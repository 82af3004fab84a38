defmodule Aerie.Fleet.Operations.Schema do
  @moduledoc "JSON Schemas of operations on many vehicles; the first is as strict as `Aerie.Fleet.Operations.Request`. Pure."

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Settings.Field
  alias Aerie.Fleet.Operations.Request
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command

  @type t :: Aerie.Base.Json.Schema.t()

  @what [command: "command_of_operation", shadow: "change_of_operation"]
  @id "^[A-Za-z0-9_-]{1,32}$"

  @doc "The request that begins one."
  @spec request() :: t()
  def request do
    common = %{
      id: described(id_schema(), "the same id is the same operation"),
      step: Map.put(integer(1, 100), :default, 20),
      pause_s: Map.put(number(0, 3_600), :default, 0),
      halt_ratio: Map.put(number(0, 1), :default, 1)
    }

    vehicles = %{type: :array, minItems: 1, maxItems: Request.max_vehicles(), items: token()}
    tag = described(text(64), "all vehicles that have it when the operation begins")
    await = %{enum: ~w(written converged), default: :written}

    what = [
      command: %{command: ref(@what[:command]), timeout_s: number(1, 300)},
      shadow: %{shadow: ref(@what[:shadow]), await: await, timeout_s: number(1, 3_600)}
    ]

    kinds =
      for {kind, properties} <- what, {target, schema} <- [vehicles: vehicles, tag: tag] do
        common |> Map.merge(properties) |> Map.put(target, schema) |> object([kind, target])
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

    change = Shadow.Document.Schema.update()

    %{
      "command_of_operation" => %{oneOf: commands},
      "change_of_operation" => %{change | properties: Map.delete(change.properties, :version)}
    }
  end

  @doc "The field that names one."
  @spec id() :: Field.t()
  def id do
    check = &if(is_binary(&1), do: {:ok, &1}, else: :error)
    words = "the id of an operation"
    Field.field(:id, {:term, check, words}, "its id", required: true, schema: id_schema())
  end

  defp id_schema, do: %{type: :string, pattern: @id}

  @doc "The properties of an operation in answers. `vehicles?`: with what became of each vehicle."
  @spec operation(vehicles? :: boolean()) :: %{atom() => t()}
  def operation(vehicles?) do
    count = %{type: :integer, minimum: 0}

    vehicle =
      object(
        %{state: %{enum: ~w(waiting under_way ok failed)}, result: %{}, reason: %{type: [:string, :null]}},
        [:state],
        open: true
      )

    properties = %{
      id: id_schema(),
      state: %{enum: ~w(running done halted stopped interrupted)},
      source: described(%{type: :string}, "who began it"),
      begun_at: %{type: :string, format: :"date-time"},
      done_at: %{type: [:string, :null], format: :"date-time"},
      what: described(what(), "its command, or its change of the desired state"),
      step: %{type: :integer, minimum: 1},
      counts: object(Map.new(~w(waiting under_way ok failed)a, &{&1, count}), [], open: true)
    }

    vehicles = if vehicles?, do: %{vehicles: %{type: :object, additionalProperties: vehicle}}, else: %{}
    Map.merge(properties, vehicles)
  end

  defp what do
    %{anyOf: for({key, name} <- @what, do: object(%{key => ref(name)}, [key]))}
  end
end
