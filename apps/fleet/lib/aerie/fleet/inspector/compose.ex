defmodule Aerie.Fleet.Inspector.Compose do
  @moduledoc """
  Makes a message of what somebody typed: its name, and text for each field. Pure.

  A number may be decimal, hexadecimal (`0x1F`) or the name of an enum's value (`MAV_MODE_AUTO` or `AUTO`); flags are joined by `|`; a float
  may be `nan`. Arrays have their elements between spaces or commas, arrays of bytes are hexadecimal digits. A field without text is 0.
  """

  alias MavCodec.Dialects.All
  alias MavCodec.Message.{Field, Value}

  @max_text 2_048

  # The dialect is an argument so that the compiler does not look at all of its messages at once, which takes it minutes.

  @doc "The names of all messages, sorted."
  @spec names(module) :: [String.t()]
  def names(dialect \\ All), do: dialect.ids() |> Enum.map(&dialect.name/1) |> Enum.sort()

  @doc """
  The fields of a message in the order of its definition; empty for an unknown name. Each has the names of its enum's
  values to choose from.
  """
  @spec fields(String.t(), module) :: [map]
  def fields(name, dialect \\ All) do
    module = module(name, dialect)

    for field <- if(module, do: module.fields(), else: []),
        do: field |> Map.from_struct() |> Map.put(:choices, choices(field))
  end

  defp module(name, dialect) do
    with id when id != nil <- dialect.message_id(name), do: dialect.module_for(id)
  end

  defp choices(%Field{enum: nil}), do: []
  defp choices(%Field{enum: enum}), do: for({name, value} <- enum.all(), do: {Atom.to_string(name), value})

  @doc "The struct, or what is wrong with each field by its name (`\"message\"`: with the name of the message)."
  @spec message(String.t(), %{String.t() => String.t()}, module) ::
          {:ok, struct} | {:error, %{String.t() => String.t()}}
  def message(name, texts, dialect \\ All) do
    case module(name, dialect) do
      nil -> {:error, %{"message" => "there is no message #{inspect(String.slice(name, 0, 60))}"}}
      module -> read(module, module.fields(), texts)
    end
  end

  defp read(module, fields, texts) do
    results =
      for field <- fields,
          do: {field, field(field, texts |> Map.get(field.name, "") |> to_string() |> String.trim())}

    errors = for {field, {:error, expected}} <- results, into: %{}, do: {field.name, "expected #{expected}"}

    if errors == %{},
      do: {:ok, struct!(module, for({field, {:ok, value}} <- results, do: {field.key, value}))},
      else: {:error, errors}
  end

  # The struct has its zero already.
  defp field(_field, ""), do: :zero
  defp field(_field, text) when byte_size(text) > @max_text, do: {:error, "a shorter text"}

  defp field(field, text) do
    with {:ok, value} <- value(field, text),
         {:ok, _bytes} <- Value.encode(value, field.type, field.length),
         do: {:ok, value}
  end

  defp value(%{type: :char}, text), do: {:ok, text}

  defp value(%{type: :uint8, length: n}, text) when n != nil do
    case text |> String.replace(["0x", " "], "") |> Base.decode16(case: :mixed) do
      {:ok, bytes} -> {:ok, bytes}
      :error -> {:error, "bytes in hexadecimal, such as 0A FF"}
    end
  end

  defp value(%{length: nil} = field, text), do: number(field, text)

  defp value(field, text) do
    text
    |> String.split([" ", ","], trim: true)
    |> Enum.reduce_while({:ok, []}, fn text, {:ok, values} ->
      case number(field, text) do
        {:ok, value} -> {:cont, {:ok, [value | values]}}
        {:error, expected} -> {:halt, {:error, expected}}
      end
    end)
    |> then(fn
      {:ok, values} -> {:ok, values |> Enum.reverse() |> fill(field.length)}
      error -> error
    end)
  end

  # The rest of an array is zeros, like a field without text.
  defp fill(values, length), do: values ++ List.duplicate(0, max(length - length(values), 0))

  defp number(%{type: type}, text) when type in [:float, :double] do
    case {String.downcase(text), Float.parse(text)} do
      {"nan", _none} -> {:ok, :nan}
      {_text, {number, ""}} -> {:ok, number}
      _other -> {:error, "a number or nan"}
    end
  end

  defp number(%{enum: enum} = field, text) do
    case integer(text) do
      {:ok, number} -> {:ok, number}
      :error when enum == nil -> {:error, range(field)}
      :error -> named(field, text)
    end
  end

  defp integer("0x" <> digits), do: parsed(Integer.parse(digits, 16))
  defp integer(text), do: parsed(Integer.parse(text))

  defp parsed({number, ""}), do: {:ok, number}
  defp parsed(_other), do: :error

  defp range(%{type: type}) do
    {low, high} = Value.range(type)
    "an integer from #{low} to #{high}"
  end

  # Names are compared as text: none of what was typed becomes an atom.
  defp named(%{enum: enum, bitmask: bitmask} = field, text) do
    all =
      for {name, value} <- enum.all(),
          name <- [Atom.to_string(name), enum.label(value) || ""],
          into: %{},
          do: {name, value}

    names = if bitmask, do: String.split(text, "|", trim: true), else: [text]
    values = for name <- names, do: all[name |> String.trim() |> String.upcase()]

    if values != [] and nil not in values,
      do: {:ok, Enum.reduce(values, 0, &Bitwise.bor/2)},
      else: {:error, "#{range(field)}, or a name of #{enum |> Module.split() |> List.last()}"}
  end
end
