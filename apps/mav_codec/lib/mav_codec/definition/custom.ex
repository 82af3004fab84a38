defmodule MavCodec.Definition.Custom do
  @moduledoc """
  A dialect outside of the official sources: what `use MavCodec.Dialect` compiles.
  """

  alias MavCodec.Definition.{Catalog, Generator, Importer, Naming, Resolver, Shard, Type}
  alias MavCodec.Definition.Catalog.Dialect

  @doc """
  The code of the dialect module that `env` is in; creates its message and enum modules. Raises
  `MavCodec.Definition.Error` for a wrong definition.
  """
  @spec define(keyword(), Macro.Env.t()) :: Macro.t()
  def define(options, env) do
    options = Keyword.validate!(options, [:definitions, base: "upstream"])
    path = options |> Keyword.fetch!(:definitions) |> Path.expand(Path.dirname(env.file))
    base = base(options[:base], env)
    {documents, paths} = load!(path, base)

    {dialect, types, enums} =
      build!(documents, Importer.document_name(path), env.module, Catalog.load!(Shard.definitions()))

    location = Macro.Env.location(env)
    Enum.each(types, &Module.create(&1.module, Generator.Messages.body(&1), location))
    Enum.each(enums, fn {module, enum} -> Module.create(module, Generator.Enums.body(enum), location) end)

    quote do
      for path <- unquote(paths), do: @external_resource(path)
      unquote(Generator.Dialects.body(dialect))
    end
  end

  defp base(name, env) do
    known = Path.join(Shard.definitions(), name)
    if File.dir?(known), do: known, else: Path.expand(name, Path.dirname(env.file))
  end

  defp load!(path, base) do
    case Importer.load([path], base) do
      {:ok, documents, paths} -> {documents, paths}
      {:error, error} -> raise error
    end
  end

  @doc """
  The dialect `module` of the file `root`, and what has to be generated for it: the message types and enums that
  `official` does not have.
  """
  @spec build!(%{String.t() => map()}, String.t(), module(), Catalog.t()) ::
          {Dialect.t(), [Type.t()], [{module(), map()}]}
  def build!(documents, root, module, official) do
    resolved =
      case Resolver.resolve(documents, root) do
        {:ok, resolved} -> resolved
        {:error, error} -> raise error
      end

    enums =
      for enum <- resolved.enums, not official_enum?(enum, official.enums) do
        {Module.concat([module, Enums, Naming.camel(enum.name)]), enum}
      end

    new = Enum.reject(resolved.messages, &Type.find(&1, official.types))

    types =
      new |> Type.all(Module.concat(module, Messages)) |> Type.with_enums(official.enums ++ enums)

    dialect = %Dialect{
      module: module,
      name: Path.basename(root, ".xml"),
      title: root,
      entries: Enum.map(resolved.messages, &(Type.find(&1, official.types) || Type.find(&1, types)))
    }

    {dialect, types, enums}
  end

  defp official_enum?(enum, official) do
    Enum.any?(official, fn {_module, known} ->
      known.name == enum.name and known.bitmask == enum.bitmask and
        Enum.all?(enum.entries, fn entry ->
          Enum.any?(known.entries, &(&1.name == entry.name and &1.value == entry.value))
        end)
    end)
  end
end
