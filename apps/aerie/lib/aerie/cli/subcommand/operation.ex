defmodule Aerie.CLI.Subcommand.Operation do
  @moduledoc """
  The subcommands that are made of operations (`Aerie.Control.Operations.Operation`): `aerie link add`,
  `aerie shadow get` … What is required is an argument, everything else an option, both with limits and defaults in the
  help. What changes something asks for confirmation, and is recorded as over REST. The answer is printed as JSON.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Access.Changes
  alias Aerie.Access.HTTP.Error
  alias Aerie.Api.Rest.{Misdirected, Operations}
  alias Aerie.Base.Json
  alias Aerie.Base.Settings.Field
  alias Aerie.CLI.{Ask, Subcommand}
  alias Aerie.CLI.Subcommand.Command
  alias Aerie.Control.Operations.Operation
  alias Aerie.Vehicle.Command.Result

  # These areas have subcommands of their own, and giving a command is `aerie cmd`.
  @own ~w(params mission recording)
  @pairs "NAME=VALUE"

  @doc "Their rows. Those that give or take the bytes of files are not among them."
  @spec rows() :: [Subcommand.t()]
  def rows, do: for({operation, route} <- all(), do: row(operation, route))

  defp all do
    for operation <- Operations.all(),
        [area, _action] <- [String.split(operation.name, ".")],
        area not in @own,
        %{media: []} = route <- Enum.take(operation.routes, 1),
        do: {operation, route}
  end

  defp name(operation), do: String.replace(operation.name, ".", " ")

  defp row(operation, route) do
    {required, optional} =
      operation |> fields() |> Enum.reject(&(&1.key in route.omit)) |> Enum.split_with(& &1.required)

    named = for name <- places(operation, route), do: {argument(name), "its #{name}"}

    yes = if changes?(operation, route), do: [{:yes, :boolean, nil, "do not ask for confirmation"}], else: []

    %Subcommand{
      name: name(operation),
      summary: summary(operation.meaning),
      where: :gateway,
      module: __MODULE__,
      arguments:
        vehicle(operation) ++
          named ++ for(field <- required, do: {argument(field.key), meaning(field)}) ++ pairs(operation),
      options: Enum.map(optional, &option/1) ++ yes,
      terms: terms(operation.request)
    }
  end

  # "Adds a link." is what it does; the help says what to do.
  defp summary(meaning) do
    <<first::utf8, rest::binary>> =
      meaning |> String.trim_trailing(".") |> String.replace(~r/^(\w+)s /, "\\1 ")

    String.downcase(<<first::utf8>>) <> rest
  end

  defp fields(operation) do
    common = Enum.reject(Operation.common(operation), &(&1.key == :id))
    Enum.reject(operation.fields ++ common, &(&1.schema == false))
  end

  # What the path names of a request that has a schema in place of fields.
  defp places(%{request: nil}, _route), do: []
  defp places(_operation, route), do: Operations.named(route)

  defp pairs(%{request: nil}), do: []
  defp pairs(_operation), do: [{"[#{@pairs} ...]", "what is asked for; a value is JSON, or else text"}]

  defp terms(nil), do: nil

  defp terms(request) do
    properties = Enum.reduce(request[:oneOf] || [request], %{}, &Map.merge(&2, &1.properties))
    {"NAME is one of:", for({name, schema} <- Enum.sort(properties), do: {"#{name}", words(schema)})}
  end

  defp words(%{description: words}), do: words
  defp words(%{enum: values}), do: values |> Enum.reject(&is_nil/1) |> Enum.join(" or ")
  defp words(%{type: type}), do: type |> List.wrap() |> Enum.reject(&(&1 == :null)) |> Enum.join(" or ")
  defp words(_schema), do: "object"

  # By one path of some, all vehicles are meant without it.
  defp vehicle(%{routes: routes}) do
    meaning = "its name in the fleet, as aerie status shows it"

    case Enum.split_with(routes, &String.starts_with?(&1.path, "/api/vehicles/:id")) do
      {[], _of_gateway} -> []
      {_of_vehicle, []} -> [{"VEHICLE", meaning}]
      _both -> [{"[VEHICLE]", meaning <> "; all if left out"}]
    end
  end

  defp changes?(operation, route), do: operation.changes? or route.change != nil

  defp argument(key), do: key |> to_string() |> String.upcase()

  defp option(%{type: :boolean} = field), do: {field.key, :boolean, nil, field.doc}
  defp option(field), do: {field.key, :string, placeholder(field.type), meaning(field)}

  defp placeholder({kind, _min, _max}) when kind in [:integer, :number], do: "N"
  defp placeholder({:enum, _values}), do: "WORD"
  defp placeholder(_type), do: "TEXT"

  defp meaning(%{doc: doc, type: type, unit: unit, default: default}) do
    limits = [Field.expected(type), unit] |> Enum.reject(&is_nil/1) |> Enum.join(" ")
    "#{doc} (#{limits}#{if default not in [nil, []], do: "; default: #{default}"})"
  end

  @impl Subcommand
  def run(%{name: name, arguments: arguments, options: options}) do
    {operation, route} = Enum.find(all(), fn {operation, _route} -> name(operation) == name end)
    vehicle = arguments["VEHICLE"]

    with {:ok, given} <- given(operation, route, arguments, options),
         {:ok, input} <- Operation.parse(operation, given),
         :ok <- Misdirected.check(route.change, :default, vehicle),
         :ok <-
           if(changes?(operation, route),
             do: Ask.first(asked(operation, route, arguments), options),
             else: :ok
           ) do
      answer = operation.module.run(input, context(vehicle, input))
      :ok = record(answer, route.change, vehicle || arguments["ID"])
      printed(answer)
    else
      error -> printed(error)
    end
  end

  defp given(operation, route, arguments, options) do
    with {:ok, object} <- Command.params(arguments[@pairs] || []) do
      named = for name <- places(operation, route), do: {name, arguments[argument(name)]}

      given =
        for field <- fields(operation),
            value = arguments[argument(field.key)] || options[field.key],
            do: {Field.name(field), value(field, value)}

      {:ok, object |> Map.merge(Map.new(named)) |> Map.merge(Map.new(given))}
    end
  end

  # What has a schema of its own may be more than a text.
  defp value(%{type: {:term, _check, _words}, schema: %{type: type}}, text) when type != :string,
    do: with({:error, _no_json} <- JSON.decode(text), do: text, else: ({:ok, value} -> value))

  defp value(%{type: {:term, _check, _words}}, text), do: text
  defp value(%{type: :boolean}, value), do: value
  defp value(_field, text), do: {:text, text}

  defp asked(operation, route, arguments) do
    %{name: name, arguments: row} = row(operation, route)
    said = for {word, _meaning} <- row, text = arguments[word], do: text
    Enum.join([name | said ++ Map.get(arguments, @pairs, [])], " ")
  end

  defp context(vehicle, input) do
    source = Command.source()

    %{
      gateway: :default,
      vehicle: vehicle,
      source: source,
      via: source.name,
      by: "aerie",
      options: [as: source, via: source.name] ++ Operation.options(input),
      format: "json",
      max_bytes: nil
    }
  end

  defp record({:error, _reason}, _change, _target), do: :ok

  defp record(answer, change, target) do
    object = with {:ok, object} <- answer, do: object
    if Changes.recorded?(change), do: Changes.request(:default, "aerie", change, target, object), else: :ok
  end

  defp printed(:ok), do: {0, "done\n"}
  defp printed({:ok, %Result{}} = answer), do: Command.answer(answer, %{})
  defp printed({:pending, _id} = answer), do: Command.answer(answer, %{})
  defp printed({:ok, object}), do: {0, object |> Json.encode!() |> JSON.decode!() |> :json.format(&format/3)}
  defp printed({:error, %Result{}} = answer), do: Command.answer(answer, %{})
  defp printed({:error, <<text::binary>>}), do: {:error, text}
  defp printed({:error, error}), do: {:error, Error.from(error).message}

  defp format(nil, _encode, _state), do: "null"
  defp format(other, encode, state), do: :json.format_value(other, encode, state)
end
