defmodule Aerie.Router.Requests do
  @moduledoc """
  Who arbitrates what clients ask of a vehicle's message rates: a module that is given to `Aerie.Router.Supervisor`
  (`:requests`). Without one all requests are forwarded as they are.
  """

  alias Aerie.Names
  alias MavCodec.Frame

  @doc "Whether a frame is such a request: cheap, it is asked of every frame of a client."
  @callback request?(Frame.t()) :: boolean

  @doc """
  A client's request on its way to a vehicle of a network: `:forward` it as it is, or `{:absorb, answer}`, `answer` being a
  frame to the client in the vehicle's name, or nil.
  """
  @callback intercept(Names.gateway(), network :: String.t(), client :: term, Frame.t()) ::
              :forward | {:absorb, binary | nil}

  @doc "A client is gone, and what it asked for with it."
  @callback forget(Names.gateway(), client :: term) :: :ok
end
