defmodule MavCodec.Dialects do
  @moduledoc """
  The dialects that are compiled in.

    * `"all"` (`MavCodec.Dialects.All`) - all messages of both official sources; where the two differ, upstream's layout
    * `"all-ardupilot"` - the same messages, where the two differ with ArduPilot's layout
    * `"upstream"`, `"ardupilot"` - the messages of one source
    * `"common"`, `"ardupilot/common"`, ... - single definition files with their includes
  """

  alias MavCodec.Definition.{Catalog, Shard}

  @files Shard.files()
  for file <- @files, do: @external_resource(file)

  @dialects for dialect <- Catalog.load!(Shard.definitions()).dialects, do: {dialect.name, dialect.module}
  @modules Map.new(@dialects)

  @doc false
  def __mix_recompile__?, do: Shard.files() != @files

  @doc "All dialects: name and module."
  @spec all() :: [{String.t(), module()}]
  def all, do: @dialects

  @doc "The dialect of a name, as configurations give it."
  @spec fetch(String.t()) :: {:ok, module()} | :error
  def fetch(name), do: Map.fetch(@modules, name)

  @doc """
  The dialect that a vehicle speaks, by the autopilot field of its heartbeat (`MavCodec.Enums.MavAutopilot`): ArduPilot has
  its own layouts of a few messages, everyone else follows upstream.
  """
  @spec for_autopilot(non_neg_integer()) :: module()
  def for_autopilot(3), do: MavCodec.Dialects.AllArdupilot
  def for_autopilot(_autopilot), do: MavCodec.Dialects.All
end
