defmodule MavCodec.Definition.Resolver do
  @moduledoc """
  Resolves the includes of a definition file (F11): recursively, each file once, cycles allowed.

  Enums of one name are merged; a message id, message name or enum value that two files use differently is an error.
  """

  alias MavCodec.Definition.{Document, Error}
  alias MavCodec.Definition.Document.{Enumeration, Message}

  @enforce_keys [:file, :files, :messages, :enums]
  defstruct [:file, :files, :messages, :enums]

  @typedoc "The whole of a dialect: files in the order of their inclusion, messages by id, enums by name."
  @type t :: %__MODULE__{
          file: String.t(),
          files: [String.t()],
          messages: [Message.t()],
          enums: [Enumeration.t()]
        }

  @doc "Resolves the file named `root` of `documents` (a map from file name to document)."
  @spec resolve(%{String.t() => Document.t()}, String.t()) :: {:ok, t()} | {:error, Error.t()}
  def resolve(documents, root) do
    files = documents |> files([root], %{}, []) |> Enum.reverse()
    # Included files first, so that an error is reported for the including file.
    all = files |> Enum.reverse() |> Enum.map(&Map.fetch!(documents, &1))
    messages = for document <- all, message <- document.messages, do: %{message | file: document.file}
    unique(messages, & &1.id, &"message id #{&1.id} (#{&1.name})")
    unique(messages, & &1.name, &"message name #{&1.name}")
    enums = merge(for document <- all, enum <- document.enums, do: {document.file, enum})
    known = MapSet.new(enums, & &1.name)
    Enum.each(messages, &check_enums(&1, known))

    {:ok, %__MODULE__{file: root, files: files, messages: Enum.sort_by(messages, & &1.id), enums: enums}}
  catch
    {:definition, error} -> {:error, error}
  end

  @doc "The file name of an include, however its path is written."
  @spec include_name(String.t()) :: String.t()
  def include_name(include), do: Path.basename(include)

  defp files(_documents, [], _seen, acc), do: acc

  defp files(documents, [file | rest], seen, acc) do
    if is_map_key(seen, file) do
      files(documents, rest, seen, acc)
    else
      document = Map.fetch!(documents, file)

      included =
        for {include, line} <- document.includes do
          name = include_name(include)
          is_map_key(documents, name) || fail(document.file, line, "included file #{include} is missing")
          name
        end

      files(documents, included ++ rest, Map.put(seen, file, true), [file | acc])
    end
  end

  defp unique(messages, key, describe) do
    Enum.reduce(messages, %{}, fn message, seen ->
      case Map.fetch(seen, key.(message)) do
        {:ok, first} ->
          fail(message.file, message.line, "#{describe.(message)} is already used by #{where(first)}")

        :error ->
          Map.put(seen, key.(message), message)
      end
    end)
  end

  defp where(message), do: "#{message.name} in #{message.file}:#{message.line}"

  defp merge(enums) do
    enums
    |> Enum.group_by(fn {_file, enum} -> enum.name end)
    |> Enum.sort()
    |> Enum.map(fn {name, [{_file, first} | _] = pieces} ->
      entries = for {file, enum} <- pieces, entry <- enum.entries, do: %{entry | file: file}

      %{
        first
        | bitmask: Enum.any?(pieces, fn {_file, enum} -> enum.bitmask end),
          entries: entries |> Enum.reduce([], &merge_entry(&1, &2, name)) |> Enum.sort_by(& &1.value)
      }
    end)
  end

  defp merge_entry(entry, entries, enum) do
    same_name = Enum.find(entries, &(&1.name == entry.name))
    same_value = Enum.find(entries, &(&1.value == entry.value))

    cond do
      same_name == nil and same_value == nil ->
        [entry | entries]

      same_name == same_value ->
        entries

      same_name != nil ->
        fail(
          entry.file,
          entry.line,
          "#{entry.name} of enum #{enum} is #{entry.value}, but #{same_name.value} in #{same_name.file}:#{same_name.line}"
        )

      true ->
        fail(
          entry.file,
          entry.line,
          "#{entry.name} of enum #{enum} has the value #{entry.value} of #{same_value.name} in " <>
            "#{same_value.file}:#{same_value.line}"
        )
    end
  end

  defp check_enums(message, known) do
    Enum.each(message.fields, fn field ->
      if field.enum && not MapSet.member?(known, field.enum),
        do:
          fail(
            message.file,
            field.line,
            "field #{field.name} of #{message.name} has the unknown enum #{field.enum}"
          )
    end)
  end

  @spec fail(String.t(), pos_integer() | nil, String.t()) :: no_return()
  defp fail(file, line, reason), do: throw({:definition, %Error{file: file, line: line, reason: reason}})
end
