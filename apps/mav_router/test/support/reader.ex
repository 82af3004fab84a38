defmodule Aerie.Reader do
  @moduledoc "Delivers frames as a link's process does, which keeps the router's cache between two reads."

  alias MavRouter.Router

  @doc "See `MavRouter.Router.deliver/4`; the calling test keeps the cache."
  @spec deliver(term, Router.origin(), [MavCodec.Frame.t()]) :: Router.outcome()
  def deliver(gateway, origin, frames) do
    {outcome, cache} = Router.deliver(gateway, origin, frames, Process.get({__MODULE__, gateway}))
    Process.put({__MODULE__, gateway}, cache)
    outcome
  end
end
