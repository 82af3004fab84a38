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
    # None of them may be null.
    all = Map.new(Request.fields(), &{&1.key, %{&1 | required: true}})

    kinds =
      for {what, own} <- [command: [], shadow: [:await]], target <- [:vehicles, :tag] do
        fields = Map.update!(all, :timeout_s, &%{&1 | schema: number(1, Request.longest_s(what))})
        keys = [:id, :step, :pause_s, :halt_ratio, :timeout_s, what, target] ++ own
        object(Map.new(keys, &{&1, Field.schema(fields[&1])}), [what, target])
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
