defmodule MavCodec.Definition.Generator.Messages do
  @moduledoc """
  The code of message modules.

  Decoding is one match of the whole payload. The first pattern, the full length with finite floats, nearly always matches.
  A shorter payload is filled with zeros and matched again; one with a NaN or an infinity is matched with its floats as
  bits.

  Encoding also has a function for the usual case, whose guards are the ranges of the fields. For other values (text, long
  lists, a NaN, a wrong value), `MavCodec.Message` encodes field by field.
  """

  alias MavCodec.Definition.{Layout, Naming, Type}
  alias MavCodec.Definition.Document.Field

  # Arrays up to this length are matched element by element; longer ones are matched as bytes, which then become a list.
  @inline 24

  @doc "The body of the module of a message type."
  @spec body(Type.t()) :: Macro.t()
  def body(%Type{} = type) do
    quote do
      @moduledoc unquote(moduledoc(type))
      @behaviour MavCodec.Message

      defstruct unquote(Macro.escape(Enum.map(type.fields, &{Naming.key(&1.name), default(&1)})))

      @type t :: %__MODULE__{unquote_splicing(Enum.map(type.fields, &{Naming.key(&1.name), field_type(&1)}))}

      @impl MavCodec.Message
      def id, do: unquote(type.id)
      @impl MavCodec.Message
      def name, do: unquote(type.name)
      @impl MavCodec.Message
      def fields, do: unquote(Macro.escape(Enum.map(type.fields, &field(&1, type))))

      @doc false
      unquote_splicing(type.layouts |> Enum.with_index() |> Enum.map(&wire/1))

      @doc false
      unquote_splicing(type.layouts |> Enum.with_index() |> Enum.flat_map(&encode/1))
      def __encode__(_layout, _message), do: nil

      @impl MavCodec.Message
      unquote_splicing(type.layouts |> Enum.with_index() |> Enum.flat_map(&decode/1))
    end
  end

  @doc "The decode function of a layout: the first is the message's own."
  @spec decoder(non_neg_integer()) :: atom()
  def decoder(0), do: :decode
  def decoder(index), do: :"decode_#{index}"

  defp wire({layout, index}) do
    fields = fn fields -> Enum.map(fields, &{Naming.key(&1.name), &1.type, &1.length}) end

    quote do
      def __wire__(unquote(index)),
        do: unquote(Macro.escape({fields.(layout.base), fields.(layout.extensions)}))
    end
  end

  defp decode({layout, index}) do
    name = decoder(index)
    fields = layout.base ++ layout.extensions
    fast = for {field, i} <- Enum.with_index(fields), do: {field, i, variables(field, i)}
    exact? = Enum.any?(fields, &float_inline?/1)

    hidden = if index > 0, do: [quote(do: @doc(false))], else: []

    clauses = [
      # This clause is first, because the others would read all fields before they find that the last is missing.
      quote do
        def unquote(name)(payload) when byte_size(payload) < unquote(layout.max) do
          # The empty first segment keeps this from becoming an append, which would put the bytes off the heap.
          unquote(name)(
            <<0::size(0), payload::binary, 0::size(unquote(layout.max) - byte_size(payload))-unit(8)>>
          )
        end
      end,
      quote do
        def unquote(name)(unquote(pattern(fast, :finite))), do: unquote(build(fast, :finite))
      end
    ]

    slow =
      if exact? do
        [
          quote do
            def unquote(name)(unquote(pattern(fast, :bits))), do: unquote(build(fast, :bits))
          end
        ]
      else
        []
      end

    hidden ++ clauses ++ slow
  end

  defp encode({layout, index}) do
    fields = layout.base ++ layout.extensions

    if Enum.all?(fields, &guarded?/1) do
      fields = for {field, i} <- Enum.with_index(fields), do: {field, i, variables(field, i)}
      keys = for {field, _i, variables} <- fields, do: {Naming.key(field.name), variables}

      guards =
        for {field, _i, variables} <- fields, variable <- List.wrap(variables), do: guard(variable, field)

      segments =
        for {field, _i, variables} <- fields,
            variable <- List.wrap(variables),
            do: segment(variable, field, :finite)

      [
        quote do
          def __encode__(unquote(index), %{unquote_splicing(keys)}) when unquote(conjunction(guards)),
            do: unquote({:<<>>, [], segments})
        end
      ]
    else
      []
    end
  end

  # The first segment is not a binary, see decode/1.
  defp guarded?(%Field{type: :char}), do: false
  defp guarded?(%Field{type: :uint8}), do: true
  defp guarded?(%Field{length: nil}), do: true
  defp guarded?(field), do: inline?(field)

  defp conjunction(guards),
    do: Enum.reduce(guards, fn guard, all -> quote(do: unquote(all) and unquote(guard)) end)

  defp guard(variable, %Field{type: :uint8, length: length}) when length != nil,
    do: quote(do: is_binary(unquote(variable)) and byte_size(unquote(variable)) == unquote(length))

  defp guard(variable, %Field{type: :double}), do: quote(do: is_float(unquote(variable)))

  defp guard(variable, %Field{type: :float}) do
    limit = MavCodec.Message.Value.largest_float()

    quote(
      do:
        is_float(unquote(variable)) and unquote(variable) <= unquote(limit) and
          unquote(variable) >= unquote(-limit)
    )
  end

  defp guard(variable, %Field{type: type}) do
    {low, high} = MavCodec.Message.Value.range(type)

    quote(
      do:
        is_integer(unquote(variable)) and unquote(variable) >= unquote(low) and
          unquote(variable) <= unquote(high)
    )
  end

  defp pattern(fields, mode) do
    segments =
      for {field, _i, variables} <- fields,
          variable <- List.wrap(variables),
          do: segment(variable, field, mode)

    {:<<>>, [], segments ++ [quote(do: _ :: binary)]}
  end

  defp build(fields, mode) do
    pairs = for {field, _i, variables} <- fields, do: {Naming.key(field.name), value(variables, field, mode)}
    {:%, [], [{:__MODULE__, [], nil}, {:%{}, [], pairs}]}
  end

  # One variable for a scalar or for a whole array, a list of them for an array that is matched element by element.
  defp variables(%Field{length: length} = field, i) do
    if inline?(field), do: for(j <- 1..length, do: variable("v#{i}_#{j}")), else: variable("v#{i}")
  end

  defp variable(name), do: Macro.var(String.to_atom(name), __MODULE__)

  defp inline?(%Field{length: nil}), do: false
  defp inline?(%Field{type: type}) when type in [:char, :uint8], do: false
  defp inline?(%Field{length: length}), do: length <= @inline

  defp float_inline?(%Field{type: type} = field),
    do: type in [:float, :double] and (field.length == nil or inline?(field))

  defp segment(variable, field, mode) do
    specifier =
      if field.type == :char or (field.length != nil and not inline?(field)) do
        quote(do: binary - size(unquote(Layout.bytes(field))))
      else
        specifier(field.type, mode)
      end

    {:"::", [], [variable, specifier]}
  end

  defp specifier(:uint8, _mode), do: quote(do: 8)
  defp specifier(:int8, _mode), do: quote(do: signed - 8)
  defp specifier(:uint16, _mode), do: quote(do: little - 16)
  defp specifier(:int16, _mode), do: quote(do: little - signed - 16)
  defp specifier(:uint32, _mode), do: quote(do: little - 32)
  defp specifier(:int32, _mode), do: quote(do: little - signed - 32)
  defp specifier(:uint64, _mode), do: quote(do: little - 64)
  defp specifier(:int64, _mode), do: quote(do: little - signed - 64)
  defp specifier(:float, :finite), do: quote(do: float - little - 32)
  defp specifier(:float, :bits), do: quote(do: little - 32)
  defp specifier(:double, :finite), do: quote(do: float - little - 64)
  defp specifier(:double, :bits), do: quote(do: little - 64)

  defp value(variables, field, mode) when is_list(variables),
    do: Enum.map(variables, &scalar(&1, field.type, mode))

  defp value(variable, %Field{type: :char}, _mode),
    do: quote(do: MavCodec.Message.Value.text(unquote(variable)))

  defp value(variable, %Field{length: nil, type: type}, mode), do: scalar(variable, type, mode)
  defp value(variable, %Field{type: :uint8}, _mode), do: variable

  defp value(variable, %Field{type: type}, _mode),
    do: quote(do: MavCodec.Message.Value.list(unquote(variable), unquote(type)))

  defp scalar(variable, :float, :bits), do: quote(do: MavCodec.Message.Value.float32(unquote(variable)))
  defp scalar(variable, :double, :bits), do: quote(do: MavCodec.Message.Value.float64(unquote(variable)))
  defp scalar(variable, _type, _mode), do: variable

  defp field_type(%Field{type: :char}), do: quote(do: binary())
  defp field_type(%Field{type: :uint8, length: length}) when length != nil, do: quote(do: binary())

  defp field_type(%Field{type: type, length: nil}), do: scalar_type(type)
  defp field_type(%Field{type: type}), do: [scalar_type(type)]

  defp scalar_type(type) when type in [:float, :double],
    do: quote(do: MavCodec.Message.Value.extended_float())

  defp scalar_type(type) when type in [:int8, :int16, :int32, :int64], do: quote(do: integer())
  defp scalar_type(_unsigned), do: quote(do: non_neg_integer())

  defp default(%Field{constant: constant}) when constant != nil, do: constant
  defp default(%Field{type: :char}), do: ""
  defp default(%Field{type: :uint8, length: length}) when length != nil, do: <<0::size(length)-unit(8)>>
  defp default(%Field{type: type, length: nil}), do: zero(type)
  defp default(%Field{type: type, length: length}), do: List.duplicate(zero(type), length)

  defp zero(type) when type in [:float, :double], do: 0.0
  defp zero(_type), do: 0

  defp field(%Field{enum: enum} = field, type) do
    %MavCodec.Message.Field{
      key: Naming.key(field.name),
      name: field.name,
      type: field.type,
      length: field.length,
      units: field.units,
      enum: enum(field, type),
      invalid: field.invalid,
      multiplier: field.multiplier,
      min: field.min,
      max: field.max,
      increment: field.increment,
      default: field.default,
      bitmask: field.bitmask or match?(%{^enum => {_module, true}}, type.enums),
      instance: field.instance,
      extension: field.extension
    }
  end

  defp enum(%Field{enum: nil}, _type), do: nil
  defp enum(%Field{enum: enum}, type), do: type.enums |> Map.fetch!(enum) |> elem(0)

  ## Documentation

  defp moduledoc(%Type{layouts: layouts} = type) do
    layout = hd(layouts)

    """
    #{type.name}, message #{type.id}: CRC_EXTRA #{layout.crc_extra}, #{lengths(layout)}.#{status(type.message)}

    | field | type | units | values |
    |---|---|---|---|
    #{Enum.map_join(type.fields, "\n", &row(&1, type))}

    On the wire: #{order(layout)}.
    #{if length(layouts) > 1, do: "\nThe extensions differ between sources: " <> Enum.map_join(layouts, "; ", &extensions/1) <> ".\n"}\
    """
  end

  defp lengths(%Layout{min: same, max: same}), do: "#{same} bytes"
  defp lengths(%Layout{min: min, max: max}), do: "#{min} bytes, #{max} with extensions"

  defp status(%{deprecated: {since, ""}}), do: " Deprecated since #{since}."
  defp status(%{deprecated: {since, by}}), do: " Deprecated since #{since}, replaced by #{by}."
  defp status(%{wip: true}), do: " Work in progress: it may change."
  defp status(_message), do: ""

  defp row(field, of) do
    type = Layout.type_name(field) <> if(field.length, do: "[#{field.length}]", else: "")
    type = if field.bytes, do: type <> ", bytes", else: type
    type = if field.extension, do: type <> ", extension", else: type

    values =
      [field.enum && "`#{inspect(enum(field, of))}`", field.invalid && "invalid: `#{field.invalid}`"]
      |> Enum.filter(& &1)
      |> Enum.join(", ")

    "| `#{Naming.key(field.name)}` | #{type} | #{field.units} | #{values} |"
  end

  defp order(layout) do
    [layout.base, layout.extensions]
    |> Enum.reject(&(&1 == []))
    |> Enum.map_join(" | ", fn fields -> Enum.map_join(fields, ", ", & &1.name) end)
  end

  defp extensions(%Layout{extensions: []}), do: "none"
  defp extensions(%Layout{extensions: extensions}), do: Enum.map_join(extensions, ", ", & &1.name)
end
