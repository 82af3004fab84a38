defmodule Aerie.Vehicle.Command.Schema do
  @moduledoc """
  JSON Schemas of commands, from the table of their types: what they take, `Aerie.Vehicle.Command.parse/2` takes. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Vehicle.Command.{Param, Result, Type, Types}

  @doc "A parameter's value."
  @spec param(Param.t()) :: Aerie.Base.Json.Schema.t()
  def param(%Param{} = param) do
    schema = param |> value() |> described(param.meaning, param.unit)
    if param.default == nil, do: schema, else: Map.put(schema, :default, param.default)
  end

  defp value(%{type: :number} = param), do: number(param.min, param.max)
  defp value(%{type: :integer} = param), do: integer(param.min, param.max)
  defp value(%{type: :boolean, values: nil}), do: %{type: :boolean}
  defp value(%{type: :boolean, values: values}), do: %{enum: values}
  defp value(%{type: :choice, values: values}), do: %{enum: values}
  defp value(%{type: :text, max: max}), do: text(max)

  defp value(%{type: :list} = param),
    do: %{type: :array, minItems: 1, maxItems: param.max, items: value(param.items)}

  @doc "The parameters of a type. null is the same as a parameter that is left out, so a required one cannot be null."
  @spec params(Type.t()) :: Aerie.Base.Json.Schema.t()
  def params(%Type{} = type) do
    properties =
      Map.new(type.params, &{&1.name, if(&1.required, do: param(&1), else: nullable(param(&1)))})

    required = for %{required: true, name: name} <- type.params, do: name
    rules = Enum.map(type.rules, &rule/1)
    object(properties, required, if(rules == [], do: [], else: [allOf: rules]))
  end

  defp rule({:any_of, names}), do: %{anyOf: Enum.map(names, &given/1)}
  defp rule({:one_of, names}), do: %{oneOf: Enum.map(names, &given/1)}

  defp rule({:together, names}),
    do: %{anyOf: [%{allOf: Enum.map(names, &given/1)}, %{not: %{anyOf: Enum.map(names, &given/1)}}]}

  defp given(name), do: %{required: [name], properties: %{name => %{not: %{type: :null}}}}

  @doc "The schemas that the others refer to, by their names: `moment`, and `params.TYPE` for each type."
  @spec shared() :: %{String.t() => Aerie.Base.Json.Schema.t()}
  def shared do
    seconds = %{type: :number, exclusiveMinimum: 0, exclusiveMaximum: 1.0e11}
    moment = described(%{anyOf: [time(), seconds]}, "a time: ISO 8601 with its offset, or unix seconds")
    for type <- Types.all(), into: %{"moment" => moment}, do: {"params.#{type.name}", params(type)}
  end

  @doc "The schema of any command with its type."
  @spec any() :: Aerie.Base.Json.Schema.t()
  def any, do: %{oneOf: for(type <- Types.all(), do: envelope(type, type?: true))}

  @doc """
  The body of a command of one type. `type?`: the body names it; over NATS the subject does. `id?`: it must have an id.
  Times are compared with the gateway's clock, which a schema cannot say.
  """
  @spec envelope(Type.t(), keyword()) :: Aerie.Base.Json.Schema.t()
  def envelope(%Type{} = type, options) do
    needed? = needed?(type)
    params = ref("params.#{type.name}")
    required = for {key, true} <- [id: options[:id?], type: options[:type?], params: needed?], do: key

    deadline =
      "nothing is sent from then on; at most 5 minutes from now, 10 seconds after it was issued unless given"

    properties = %{
      id: described(token(), "the same id is the same command"),
      type: if(options[:type?], do: %{const: type.name}, else: %{enum: [type.name, nil]}),
      params: if(needed?, do: params, else: nullable(params)),
      source: described(text(64), "a remark for the audit log: who says that it commands"),
      issued_at: described(nullable(ref("moment")), "at most 10 minutes ago and 5 seconds ahead"),
      deadline: described(nullable(ref("moment")), deadline)
    }

    vehicle = %{vehicle: described(nullable(token()), "if given, the vehicle of the subject")}
    properties = if options[:type?], do: properties, else: Map.merge(properties, vehicle)
    described(object(properties, required), type.meaning)
  end

  # Rules that want one of several parameters also hold when none is given.
  defp needed?(type),
    do: Enum.any?(type.params, & &1.required) or Enum.any?(type.rules, &(elem(&1, 0) in [:one_of, :any_of]))

  @doc "A result; further keys are details, such as `mav_result`, `retries` or `remarks`."
  @spec result() :: Aerie.Base.Json.Schema.t()
  def result do
    object(
      %{
        id: described(nullable(token()), "the request's id; null if it had no valid one"),
        result:
          described(
            nullable(%{enum: statuses()}),
            "null: it is still under way; progress and the result are asked for by its id"
          ),
        reason: described(%{type: [:string, :null]}, "a sentence for people; null only for a plain success"),
        rule: described(%{type: :string}, "which rule refused it"),
        remarks: %{type: :array, items: %{type: :string}}
      },
      [:id, :result, :reason],
      open: true
    )
  end

  defp statuses, do: for({status, _meaning, _done?} <- Result.table(), do: Atom.to_string(status))
end
