defmodule Aerie.Fleet.Operations.Schema do
  @moduledoc "JSON Schemas of operations on many vehicles; the first is as strict as `Aerie.Fleet.Operations.Request`. Pure."

  import Aerie.Base.Json.Schema

  alias Aerie.Base.Settings.Field
  alias Aerie.Fleet.Operations.{Request, Sequence}
  alias Aerie.Fleet.Shadow
  alias Aerie.Vehicle.Command

  @type t :: Aerie.Base.Json.Schema.t()

  @what [command: "command_of_operation", shadow: "change_of_operation"]
  @id "^[A-Za-z0-9_-]{1,32}$"

  @doc "The request that begins one."
  @spec request() :: t()
  def request do
    kinds =
      for {kind, required} <- [
            command: [:command, :vehicles],
            command: [:command, :tag],
            shadow: [:shadow, :vehicles],
            shadow: [:shadow, :tag],
            sequence: [:sequence]
          ] do
        # None of them may be null.
        fields =
          for field <- Request.fields(kind), field.key not in ([:vehicles, :tag] -- required), do: field

        object(Map.new(fields, &{&1.key, Field.schema(%{&1 | required: true})}), required)
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
      "step_of_operation" => Sequence.step_schema(),
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

  @doc "The field that says how flights are ended."
  @spec ending(default :: :hold | :rtl) :: Field.t()
  def ending(default),
    do: Field.field(:command, {:enum, [:hold, :rtl, :land]}, "what ends the flights", default: default)

  defp id_schema, do: %{type: :string, pattern: @id}

  @doc "The properties of an operation in answers. `vehicles?`: with what became of each vehicle."
  @spec operation(vehicles? :: boolean()) :: %{atom() => t()}
  def operation(vehicles?) do
    count = %{type: :integer, minimum: 0}

    vehicle =
      object(
        %{
          state: %{enum: ~w(waiting under_way ok failed)},
          step: described(%{type: [:string, :null]}, "of one under way in a sequence: its step"),
          result: %{},
          reason: %{type: [:string, :null]}
        },
        [:state],
        open: true
      )

    properties = %{
      id: id_schema(),
      name: described(%{type: [:string, :null]}, "what it is called on the pages"),
      state: %{enum: ~w(running paused done halted stopped interrupted)},
      source: described(%{type: :string}, "who began it"),
      begun_at: %{type: :string, format: :"date-time"},
      done_at: %{type: [:string, :null], format: :"date-time"},
      what:
        described(what(), "its command, its change of the desired state, or the steps of its first vehicle"),
      step: %{type: :integer, minimum: 1},
      then:
        described(%{type: [:string, :null]}, "the operation that ends the flights of those that had begun"),
      counts: object(Map.new(~w(waiting under_way ok failed)a, &{&1, count}), [], open: true)
    }

    vehicles = %{
      order: described(%{type: :array, items: %{type: :string}}, "its vehicles as they begin"),
      vehicles: %{type: :object, additionalProperties: vehicle}
    }

    Map.merge(properties, if(vehicles?, do: vehicles, else: %{}))
  end

  defp what do
    steps = object(%{sequence: %{type: :array, items: %{type: :string}}}, [:sequence])
    %{anyOf: for({key, name} <- @what, do: object(%{key => ref(name)}, [key])) ++ [steps]}
  end
end
