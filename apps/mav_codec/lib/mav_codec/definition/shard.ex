defmodule MavCodec.Definition.Shard do
  @moduledoc """
  One part of the generated modules. Each part is a file, so that Mix compiles them in parallel.

      use MavCodec.Definition.Shard, messages: {1, 8}

  creates every eighth message module, from the first. They are recompiled when a facts file changes or is added.
  """

  alias MavCodec.Definition.Catalog
  alias MavCodec.Definition.Generator

  @definitions Path.expand("../../../priv/definitions", __DIR__)

  @doc "The folder of the definitions."
  @spec definitions() :: Path.t()
  def definitions, do: @definitions

  @doc "The present facts files, to detect whether one was added or removed."
  @spec files() :: [Path.t()]
  def files, do: Catalog.files(@definitions)

  defmacro __using__([{kind, {part, parts}}]) do
    create(kind, part, parts, __CALLER__)

    quote do
      @moduledoc false
      @files MavCodec.Definition.Shard.files()
      for file <- @files, do: @external_resource(file)

      @doc false
      def __mix_recompile__?, do: MavCodec.Definition.Shard.files() != @files
    end
  end

  defp create(kind, part, parts, env) do
    catalog = Catalog.load!(@definitions)

    kind
    |> modules(catalog)
    |> Enum.drop(part - 1)
    |> Enum.take_every(parts)
    |> Enum.each(fn {module, body} -> Module.create(module, body.(), Macro.Env.location(env)) end)
  end

  defp modules(:messages, catalog),
    do: Enum.map(catalog.types, &{&1.module, fn -> Generator.Messages.body(&1) end})

  defp modules(:enums, catalog),
    do: Enum.map(catalog.enums, fn {module, enum} -> {module, fn -> Generator.Enums.body(enum) end} end)

  defp modules(:dialects, catalog),
    do: Enum.map(catalog.dialects, &{&1.module, fn -> Generator.Dialects.body(&1) end})
end
