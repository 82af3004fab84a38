defmodule MavCodec.Definition.Type do
  @moduledoc """
  A message module to be generated: `fields` is the union over `layouts`, in XML order; `message` is the definition that
  ranks first; `enums` are the enums of its fields: `%{name => {module, bitmask?}}`.
  """

  alias MavCodec.Definition.{Layout, Naming}
  alias MavCodec.Definition.Document.{Enumeration, Field, Message}

  @enforce_keys [:module, :id, :name, :fields, :layouts]
  defstruct [:module, :id, :name, :fields, :layouts, :message, enums: %{}]

  @type t :: %__MODULE__{
          module: module() | nil,
          id: 0..0xFFFFFF,
          name: String.t(),
          fields: [Field.t()],
          layouts: [Layout.t()],
          message: Message.t() | nil,
          enums: %{String.t() => {module(), boolean()}}
        }

  @doc """
  The message types of messages in rank order (so that the names of official messages never depend on added
  ones), with their modules under `namespace`.
  """
  @spec all([Message.t()], module()) :: [t()]
  def all(messages, namespace) do
    distinct = Enum.uniq_by(messages, &signature/1)
    ranks = distinct |> Enum.with_index() |> Map.new(fn {message, rank} -> {message, rank} end)

    distinct
    |> Enum.reduce(%{}, &add_type/2)
    |> Enum.flat_map(fn {_name, types} -> types end)
    |> Enum.sort_by(&Map.fetch!(ranks, &1.message))
    |> name_types(namespace)
    |> Enum.sort_by(&{&1.id, &1.name})
  end

  defp signature(%Message{} = message),
    do: {message.id, message.name, Enum.map(message.fields, &{&1.name, &1.type, &1.length, &1.extension})}

  # `types` by name, since there are hundreds.
  defp add_type(message, types) do
    {base, _extensions} = Layout.order(message.fields)
    layout = Layout.of(message)

    Map.update(types, message.name, [new_type(message, layout)], fn same_name ->
      case Enum.split_while(same_name, &(not same_type?(&1, message, base))) do
        {before, [type | rest]} -> before ++ [extend(type, message, layout) | rest]
        {all, []} -> all ++ [new_type(message, layout)]
      end
    end)
  end

  defp new_type(message, layout) do
    %__MODULE__{
      module: nil,
      id: message.id,
      name: message.name,
      fields: message.fields,
      layouts: [layout],
      message: message
    }
  end

  defp extend(type, message, layout) do
    known = MapSet.new(type.fields, & &1.name)
    more = Enum.reject(message.fields, &MapSet.member?(known, &1.name))
    %{type | fields: type.fields ++ more, layouts: type.layouts ++ [layout]}
  end

  # They share a module if their bases are equal and no extension has two types.
  defp same_type?(type, message, base) do
    type.id == message.id and type.name == message.name and shape(hd(type.layouts).base) == shape(base) and
      Enum.all?(message.fields, fn field ->
        Enum.all?(
          type.fields,
          &(&1.name != field.name or (&1.type == field.type and &1.length == field.length))
        )
      end)
  end

  defp shape(fields), do: Enum.map(fields, &{&1.name, &1.type, &1.length})

  # Module names are unique regardless of case, because they become file names. The first message keeps the name, a later
  # one gets its id appended.
  defp name_types(types, namespace) do
    {types, _taken} =
      types
      |> Enum.map_reduce(MapSet.new(), fn type, taken ->
        plain = Naming.camel(type.name)
        name = if MapSet.member?(taken, String.downcase(plain)), do: "#{plain}#{type.id}", else: plain
        {%{type | module: Module.concat(namespace, name)}, MapSet.put(taken, String.downcase(name))}
      end)

    types
  end

  @doc "The type among `types` that a message is, with the index of its layout; `nil` if there is none."
  @spec find(Message.t(), [t()]) :: {t(), non_neg_integer()} | nil
  def find(message, types) do
    {base, extensions} = Layout.order(message.fields)

    Enum.find_value(types, fn type ->
      if same_type?(type, message, base) do
        index = Enum.find_index(type.layouts, &(shape(&1.extensions) == shape(extensions)))
        index && {type, index}
      end
    end)
  end

  @doc "Adds the modules of their fields' enums to types; of two enums with one name the last counts."
  @spec with_enums([t()], [{module(), Enumeration.t()}]) :: [t()]
  def with_enums(types, enums) do
    known = Map.new(enums, fn {module, enum} -> {enum.name, {module, enum.bitmask}} end)
    Enum.map(types, fn type -> %{type | enums: Map.take(known, Enum.map(type.fields, & &1.enum))} end)
  end
end
