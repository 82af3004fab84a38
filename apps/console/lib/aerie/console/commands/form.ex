defmodule Aerie.Console.Commands.Form do
  @moduledoc """
  The form of a command, made from its row (`Aerie.Vehicle.Command.type/1`), and the parameters from a browser's input. Pure.

  A form describes each parameter, but only `Aerie.Vehicle.Command.check/2` validates values: input that cannot be read as a
  number is passed to it as text.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Firmware

  @max_text 256
  @max_items 64

  # Names that are not words.
  @labels %{
    "lat" => "latitude",
    "lon" => "longitude",
    "altitude_msl" => "altitude (MSL)",
    "altitude_reference" => "altitude above",
    "seq" => "item",
    "pwm" => "pulse width",
    "setpoints_elsewhere" => "set-points from elsewhere"
  }

  @typedoc """
    * `:input` - the kind of control; a boolean with one allowed value is a `:tick`
    * `:value` - the initial text
    * `:suggestions` - texts to choose from; other input is allowed
  """
  @type field :: %{
          name: String.t(),
          label: String.t(),
          input: :number | :integer | :boolean | :tick | :choice | :text | :list,
          value: String.t(),
          values: [String.t()],
          suggestions: [String.t()],
          min: String.t() | nil,
          max: String.t() | nil,
          unit: String.t() | nil,
          required: boolean(),
          meaning: String.t()
        }

  @typedoc "Errors by the names of fields, and errors about several fields."
  @type errors :: %{fields: %{String.t() => String.t()}, general: [String.t()]}

  @doc """
  The fields of a command for a vehicle (its snapshot, for suggestions); `given` are texts that replace the defaults.
  """
  @spec fields(map(), vehicle :: map() | nil, %{String.t() => String.t()}) :: [field()]
  def fields(type, vehicle \\ nil, given \\ %{}),
    do: for(param <- type.params, do: field(param, suggestions(type.name, param.name, vehicle), given))

  defp field(param, suggestions, given) do
    name = Atom.to_string(param.name)

    %{
      name: name,
      label: @labels[name] || String.replace(name, "_", " "),
      input: input(param),
      value: Map.get(given, name) || text(param.default),
      values: Enum.map(param.values || [], &to_string/1),
      suggestions: suggestions,
      min: bound(param, param.min),
      max: bound(param, param.max),
      unit: param.unit || (param.items && param.items.unit),
      required: param.required,
      meaning: param.meaning
    }
  end

  defp input(%{type: :boolean, values: [_one]}), do: :tick
  defp input(%{type: type}), do: type

  defp bound(%{type: type}, number) when type in [:number, :integer] and is_number(number),
    do: Json.number(number)

  defp bound(_param, _none), do: nil

  defp text(nil), do: ""
  defp text(number) when is_number(number), do: Json.number(number)
  defp text(list) when is_list(list), do: Enum.map_join(list, ", ", &text/1)
  defp text(other), do: to_string(other)

  defp suggestions("set_mode", :mode, %{} = vehicle), do: Firmware.modes(vehicle)
  defp suggestions(_type, _param, _vehicle), do: []

  @doc "The parameters of a command from the texts of its form."
  @spec read(map(), term()) :: {:ok, %{String.t() => term()}} | {:error, errors()}
  def read(type, texts) when is_map(texts) do
    given =
      for param <- type.params,
          {:ok, value} <- [value(param, texts)],
          into: %{},
          do: {Atom.to_string(param.name), value}

    case Command.check(type, given) do
      {:ok, _checked} -> {:ok, given}
      {:error, errors} -> {:error, sorted(errors)}
    end
  end

  def read(type, _nothing), do: read(type, %{})

  # An empty field means that the parameter is not given.
  defp value(param, texts) do
    with text when is_binary(text) <- Map.get(texts, Atom.to_string(param.name)),
         text = text |> String.slice(0, @max_text) |> String.trim(),
         true <- text != "" do
      value_of(param, text)
    else
      _none -> :none
    end
  end

  # A checkbox that is not ticked.
  defp value_of(%{type: :boolean, values: [true]}, "false"), do: :none
  defp value_of(param, text), do: {:ok, read_text(param, text)}

  defp read_text(%{type: type}, text) when type in [:number, :integer], do: number(text)
  defp read_text(%{type: :boolean}, "true"), do: true
  defp read_text(%{type: :boolean}, "false"), do: false

  defp read_text(%{type: :list, items: items}, text),
    do:
      text
      |> String.split([",", " ", ";"], trim: true)
      |> Enum.take(@max_items)
      |> Enum.map(&read_text(items, &1))

  defp read_text(_param, text), do: text

  defp number(text) do
    with :error <- whole(Integer.parse(text)), :error <- whole(Float.parse(text)), do: text
  end

  defp whole({number, ""}), do: number
  defp whole(_part), do: :error

  defp sorted(errors) do
    {fields, general} = Enum.split_with(errors, &match?(%{key: "params." <> _name}, &1))

    %{
      fields:
        Map.new(Enum.reverse(fields), fn %{key: "params." <> name} = error -> {top(name), message(error)} end),
      general: Enum.map(general, &message/1)
    }
  end

  # `channels[3]` belongs to the field `channels`.
  defp top(name), do: name |> String.split("[") |> hd()

  defp message(%{got: nil} = error), do: "expected #{error.expected}"
  defp message(%{got: "nothing"} = error), do: "expected #{error.expected}"
  defp message(error), do: "expected #{error.expected}, got #{error.got}"
end
