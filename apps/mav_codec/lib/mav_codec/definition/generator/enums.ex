defmodule MavCodec.Definition.Generator.Enums do
  @moduledoc "The code of enum modules."

  alias MavCodec.Definition.Document.Enumeration
  alias MavCodec.Definition.Naming

  @doc "The body of the module of an enum."
  @spec body(Enumeration.t()) :: Macro.t()
  def body(%Enumeration{} = enum) do
    names = Enum.map(enum.entries, & &1.name)

    entries =
      Enum.zip_with(enum.entries, Naming.labels(enum.name, names), &{String.to_atom(&1.name), &1.value, &2})

    first = Enum.uniq_by(entries, fn {_name, value, _label} -> value end)

    quote do
      @moduledoc unquote(moduledoc(enum))

      @doc "The value of an entry, or `nil`."
      @spec value(atom()) :: non_neg_integer() | nil
      unquote_splicing(
        for {name, value, _} <- entries, do: quote(do: def(value(unquote(name)), do: unquote(value)))
      )

      def value(name) when is_atom(name), do: nil

      @doc "The name of a value, or `nil` for an unknown one."
      @spec name(integer()) :: atom()
      unquote_splicing(
        for {name, value, _} <- first, do: quote(do: def(name(unquote(value)), do: unquote(name)))
      )

      def name(value) when is_integer(value), do: nil

      @doc "The name of a value without the common prefix of the enum's names, or `nil`."
      @spec label(integer()) :: String.t() | nil
      unquote_splicing(
        for {_, value, label} <- first, do: quote(do: def(label(unquote(value)), do: unquote(label)))
      )

      def label(value) when is_integer(value), do: nil

      @doc "All entries with their values, by value."
      @spec all() :: [{atom(), non_neg_integer()}]
      def all, do: unquote(for {name, value, _label} <- entries, do: {name, value})

      unquote(if enum.bitmask, do: flags())
      unquote(if Enum.any?(enum.entries, &(&1.params != [])), do: params(enum))
      unquote(if Enum.any?(enum.entries, &location/1), do: locations(enum))
    end
  end

  defp flags do
    quote do
      @doc "The flags that are set, and the bits without a name."
      @spec flags(non_neg_integer()) :: {[atom()], unknown_bits :: non_neg_integer()}
      def flags(value), do: MavCodec.Enums.flags(value, all())
    end
  end

  defp params(enum) do
    params =
      for entry <- enum.entries, entry.params != [], do: {entry.value, Enum.map(entry.params, &param/1)}

    quote do
      @doc "The parameters of a command that its definition describes, by index."
      @spec params(integer()) :: [MavCodec.Enums.Param.t()]
      unquote_splicing(
        for {value, list} <- params,
            do: quote(do: def(params(unquote(value)), do: unquote(Macro.escape(list))))
      )

      def params(value) when is_integer(value), do: []
    end
  end

  defp locations(enum) do
    known = for entry <- enum.entries, location = location(entry), do: {entry.value, location == "true"}

    quote do
      @doc "Whether parameters 5 to 7 of a command are a position, or `nil` if its definition does not say."
      @spec location?(integer()) :: boolean() | nil
      unquote_splicing(
        for {value, location?} <- known, do: quote(do: def(location?(unquote(value)), do: unquote(location?)))
      )

      def location?(value) when is_integer(value), do: nil
    end
  end

  defp location(%{facts: facts}), do: List.keyfind(facts, "hasLocation", 0, {nil, nil}) |> elem(1)

  defp param({index, facts}) do
    facts = Map.new(facts)

    %MavCodec.Enums.Param{
      index: index,
      label: facts["label"],
      units: facts["units"],
      enum: facts["enum"],
      min: number(facts["minValue"]),
      max: number(facts["maxValue"]),
      increment: number(facts["increment"]),
      default: number(facts["default"]),
      reserved: facts["reserved"] == "true"
    }
  end

  defp number(nil), do: nil

  defp number(text) do
    case Float.parse(text) do
      {number, ""} -> number
      _other -> if String.downcase(text) == "nan", do: :nan
    end
  end

  defp moduledoc(enum) do
    kind = if enum.bitmask, do: "Flags", else: "Values"

    """
    #{kind} of #{enum.name}.

    | value | name |
    |---|---|
    #{Enum.map_join(enum.entries, "\n", &"| #{&1.value} | `#{&1.name}` |")}
    """
  end
end
