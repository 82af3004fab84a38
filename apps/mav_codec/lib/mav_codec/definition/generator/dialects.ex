defmodule MavCodec.Definition.Generator.Dialects do
  @moduledoc """
  The code of dialect modules. Every lookup is a jump on the message id.
  """

  alias MavCodec.Definition.Catalog.Dialect
  alias MavCodec.Definition.Generator.Messages

  @doc "The body of the module of a dialect."
  @spec body(Dialect.t()) :: Macro.t()
  def body(%Dialect{entries: entries} = dialect) do
    quote do
      @moduledoc unquote("The dialect #{dialect.title}: #{length(entries)} messages.")
      @behaviour MavCodec.Dialect

      @impl MavCodec.Dialect
      def crc_extra(id), do: unquote(by_id(entries, fn _type, _index, layout -> layout.crc_extra end))

      # A function as a value: the compiler would join the types of all messages in each clause.
      @impl MavCodec.Dialect
      def decode(id, payload) do
        case decoder(id) do
          nil -> {:error, %MavCodec.Message.DecodeError{id: id, dialect: __MODULE__}}
          decoder -> {:ok, decoder.(payload)}
        end
      end

      defp decoder(id) do
        unquote(
          by_id(entries, fn type, index, _layout ->
            quote(do: &(unquote(type.module).unquote(Messages.decoder(index)) / 1))
          end)
        )
      end

      @impl MavCodec.Dialect
      def module_for(id), do: unquote(by_id(entries, fn type, _index, _layout -> type.module end))

      @impl MavCodec.Dialect
      def length(id), do: unquote(by_id(entries, fn _type, _index, layout -> {layout.min, layout.max} end))

      @impl MavCodec.Dialect
      def targets(id), do: unquote(by_id(entries, fn _type, _index, layout -> targets(layout) end))

      @impl MavCodec.Dialect
      def name(id), do: unquote(by_id(entries, fn type, _index, _layout -> type.name end))

      @impl MavCodec.Dialect
      def message_id(name) do
        case unquote(Macro.escape(Map.new(entries, fn {type, _} -> {type.name, type.id} end))) do
          %{^name => id} -> id
          _unknown -> nil
        end
      end

      @impl MavCodec.Dialect
      def ids, do: unquote(Enum.map(entries, fn {type, _} -> type.id end))

      @impl MavCodec.Dialect
      def encoder(module), do: unquote(choice(quote(do: module), Enum.map(entries, &encoder/1)))

      @impl MavCodec.Dialect
      def layout(module) do
        with {id, crc_extra, _min, layout} <- encoder(module) do
          {base, extensions} = module.__wire__(layout)
          {id, crc_extra, base, extensions}
        end
      end
    end
  end

  defp by_id(entries, value) do
    choice(
      quote(do: id),
      for({type, index} <- entries, do: {type.id, value.(type, index, Enum.at(type.layouts, index))})
    )
  end

  defp choice(subject, pairs) do
    clauses = for {key, value} <- pairs, do: {:->, [], [[key], value]}
    {:case, [], [subject, [do: clauses ++ [{:->, [], [[quote(do: _)], nil]}]]]}
  end

  defp targets(%{target_system: nil, target_component: nil}), do: nil
  defp targets(%{target_system: system, target_component: component}), do: {system, component}

  defp encoder({type, index}) do
    layout = Enum.at(type.layouts, index)
    {type.module, Macro.escape({type.id, layout.crc_extra, layout.min, index})}
  end
end
