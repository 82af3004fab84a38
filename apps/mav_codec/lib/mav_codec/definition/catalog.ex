defmodule MavCodec.Definition.Catalog do
  @moduledoc """
  Merges all sources of definitions: which message, enum and dialect modules there are.

  A source is a folder of facts files under `priv/definitions`. Sources rank: `upstream`, `ardupilot`, then the others by
  name. A message that several sources define becomes one module with the union of the fields; where only extensions
  differ, it has several layouts and the dialect decides which one is on the wire.
  """

  alias MavCodec.Definition.{Document, Error, Facts, Naming, Resolver, Type}
  alias MavCodec.Definition.Document.Enumeration

  @ranked ["upstream", "ardupilot"]
  @wholes Enum.map(@ranked, &Naming.dialect(&1, "all.xml"))

  defmodule Dialect do
    @moduledoc "A dialect module: `name` as people write it, `entries` are `{type, layout index}`, by id."
    @enforce_keys [:module, :name, :title, :entries]
    defstruct [:module, :name, :title, :entries]

    @type t :: %__MODULE__{}
  end

  @enforce_keys [:types, :enums, :dialects]
  defstruct [:types, :enums, :dialects]

  @type t :: %__MODULE__{
          types: [Type.t()],
          enums: [{module(), Enumeration.t()}],
          dialects: [Dialect.t()]
        }

  @doc "All facts files under a folder of sources, sorted."
  @spec files(Path.t()) :: [Path.t()]
  def files(folder), do: folder |> Path.join("*/*.facts") |> Path.wildcard() |> Enum.sort()

  @doc """
  Loads the sources under `folder`. The last result is kept while the files stay as they are, since each shard of the
  compilation asks for it.
  """
  @spec load!(Path.t()) :: t()
  def load!(folder) do
    stamp = for file <- files(folder), stat = File.stat!(file), do: {file, stat.mtime, stat.size}

    case :persistent_term.get({__MODULE__, folder}, nil) do
      {^stamp, catalog} ->
        catalog

      _other ->
        catalog = folder |> sources!() |> build!()
        :persistent_term.put({__MODULE__, folder}, {stamp, catalog})
        catalog
    end
  end

  @doc "The sources under a folder, in rank order: `{name, %{file name => document}}`."
  @spec sources!(Path.t()) :: [{String.t(), %{String.t() => Document.t()}}]
  def sources!(folder) do
    folder
    |> files()
    |> Enum.group_by(&Path.basename(Path.dirname(&1)))
    |> Enum.sort_by(fn {name, _files} -> {rank(name), name} end)
    |> Enum.map(fn {name, files} -> {name, Map.new(files, &read!/1)} end)
  end

  defp rank(name), do: Enum.find_index(@ranked, &(&1 == name)) || length(@ranked)

  @doc "Reads one facts file."
  @spec read!(Path.t()) :: {String.t(), Document.t()}
  def read!(path) do
    case path |> File.read!() |> Facts.facts() |> Facts.document(path) do
      {:ok, document} -> {document.file, document}
      {:error, error} -> raise error
    end
  end

  @doc "Merges sources; raises `MavCodec.Definition.Error` where they contradict each other."
  @spec build!([{String.t(), %{String.t() => Document.t()}}]) :: t()
  def build!(sources) do
    resolved =
      for {source, documents} <- sources, file <- documents |> Map.keys() |> Enum.sort() do
        {source, file, resolve!(documents, file)}
      end

    messages = for {source, _documents} <- sources, message <- messages(source, resolved), do: message
    enums = merge_enums(for {_source, _file, dialect} <- resolved, enum <- dialect.enums, do: enum)
    types = messages |> Type.all(MavCodec.Messages) |> Type.with_enums(enums)
    by_name = Enum.group_by(types, & &1.name)
    # Most files include common.xml, so most messages occur many times.
    found = messages |> Enum.uniq() |> Map.new(&{&1, Type.find(&1, by_name[&1.name])})

    dialects =
      for {source, file, dialect} <- resolved do
        %Dialect{
          module: Naming.dialect(source, file),
          name: Naming.dialect_name(source, file),
          title: "#{file} of #{source}",
          entries: Enum.map(dialect.messages, &Map.fetch!(found, &1))
        }
      end

    catalog = %__MODULE__{types: types, enums: enums, dialects: with_all(dialects)}
    unique_modules!(catalog)
    catalog
  end

  defp messages(source, resolved) do
    messages = for {^source, _file, dialect} <- resolved, message <- dialect.messages, do: message
    Enum.sort_by(messages, & &1.id)
  end

  # Enums of one name in several sources become one module. Two sources may name one value differently.
  defp merge_enums(enums) do
    enums
    |> Enum.group_by(& &1.name)
    |> Enum.sort()
    |> Enum.map(fn {name, pieces} ->
      entries = pieces |> Enum.flat_map(& &1.entries) |> Enum.reduce(%{}, &add_entry(&1, &2, name))
      # If a value has two names, that of the higher-ranking source comes first.
      entries = entries |> Map.values() |> Enum.sort_by(fn {index, entry} -> {entry.value, index} end)

      {Naming.enum(name),
       %{hd(pieces) | bitmask: Enum.any?(pieces, & &1.bitmask), entries: Enum.map(entries, &elem(&1, 1))}}
    end)
  end

  defp add_entry(entry, entries, enum) do
    case Map.fetch(entries, entry.name) do
      :error ->
        Map.put(entries, entry.name, {map_size(entries), entry})

      {:ok, {_index, %{value: value}}} when value == entry.value ->
        entries

      {:ok, {_index, first}} ->
        raise Error,
          file: entry.file,
          line: entry.line,
          reason:
            "#{entry.name} of enum #{enum} is #{entry.value}, but #{first.value} in #{first.file} of another source"
    end
  end

  defp resolve!(documents, file) do
    case Resolver.resolve(documents, file) do
      {:ok, dialect} -> dialect
      {:error, error} -> raise error
    end
  end

  # The messages of both official sources, with the layouts of one of them where they differ.
  defp with_all(dialects) do
    case Enum.map(@wholes, fn module -> Enum.find(dialects, &(&1.module == module)) end) do
      [%Dialect{} = upstream, %Dialect{} = ardupilot] ->
        [
          merge("all", "All", upstream, ardupilot),
          merge("all-ardupilot", "AllArdupilot", ardupilot, upstream) | dialects
        ]

      _other ->
        dialects
    end
  end

  defp merge(name, module, first, second) do
    known = MapSet.new(first.entries, fn {type, _layout} -> type.name end)
    more = Enum.reject(second.entries, fn {type, _layout} -> MapSet.member?(known, type.name) end)
    entries = Enum.sort_by(first.entries ++ more, fn {type, _layout} -> type.id end)
    unique_ids!(entries)

    %Dialect{
      module: Naming.joined(module),
      name: name,
      title: "#{first.title} with the messages that only #{second.title} has",
      entries: entries
    }
  end

  defp unique_ids!(entries) do
    entries
    |> Enum.zip(Enum.drop(entries, 1))
    |> Enum.each(fn {{a, _}, {b, _}} ->
      if a.id == b.id do
        raise Error,
          file: "all.xml",
          line: nil,
          reason: "message id #{a.id} is #{a.name} in one source and #{b.name} in another"
      end
    end)
  end

  defp unique_modules!(catalog) do
    modules =
      Enum.map(catalog.types, & &1.module) ++
        Enum.map(catalog.enums, &elem(&1, 0)) ++ Enum.map(catalog.dialects, & &1.module)

    modules
    |> Enum.frequencies_by(&(&1 |> inspect() |> String.downcase()))
    |> Enum.each(fn {name, count} ->
      if count > 1,
        do:
          raise(Error,
            file: "priv/definitions",
            line: nil,
            reason: "#{count} definitions give the module #{name}"
          )
    end)
  end
end
