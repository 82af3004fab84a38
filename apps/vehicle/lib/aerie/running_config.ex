defmodule Aerie.RunningConfig do
  @moduledoc "The configuration that a running gateway was started with, for the parts that start while it runs."

  alias Aerie.Identity
  alias Aerie.Names

  @doc "It, or nil when there is no such gateway. A `mavlink.system_id` that was to be found out is the one that was."
  @spec of(Names.gateway()) :: term() | nil
  def of(gateway), do: gateway |> Names.value(:gateway) |> Identity.resolve(gateway)
end
