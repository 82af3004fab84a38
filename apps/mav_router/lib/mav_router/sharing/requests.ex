defmodule MavRouter.Sharing.Requests do
  @moduledoc """
  The module that arbitrates between clients' requests for message rates, given to `MavRouter.Router.Supervisor` (`:requests`). Without
  one all requests are forwarded.
  """

  alias Aerie.Base.Names
  alias MavCodec.Frame

  @doc "Whether a frame is such a request. Must be cheap: it is asked of every frame of a client."
  @callback request?(Frame.t()) :: boolean

  @doc """
  A client's request to a vehicle of a network: `:forward` it, or `{:absorb, answer}`, where `answer` is a frame to the client in the
  vehicle's name, or nil.
  """
  @callback intercept(Names.gateway(), network :: String.t(), client :: term, Frame.t()) ::
              :forward | {:absorb, binary | nil}

  @doc "A client is gone: its requests are forgotten."
  @callback forget(Names.gateway(), client :: term) :: :ok
end
