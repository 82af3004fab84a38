defmodule MavRouter.Router.Policy do
  @moduledoc """
  The module that knows who clients are and decides which of their frames reach a vehicle, given to `MavRouter.Router.Supervisor`
  (`:policy`). Without one every client may send everything that `MavCodec.Meaning.Messages` has a row for.

  It runs in the process that received the frame: it must not wait. It is never asked about telemetry of vehicles.
  """

  alias Aerie.Base.Principal
  alias Aerie.Base.Names
  alias MavRouter.Forward.Table.Path
  alias MavCodec.Frame

  @typedoc "The sender: the endpoint, its client or link, its address in words, and its principal."
  @type sender :: %{
          endpoint: MavRouter.Endpoints.Endpoint.key(),
          owner: String.t(),
          peer: String.t() | nil,
          principal: Principal.t()
        }

  @doc "The principal of an endpoint, whether it counts as a client (`MavRouter.Endpoints.Access`) or not."
  @callback principal(Names.gateway(), Path.t()) :: Principal.t()

  @doc """
  A frame on its way to a vehicle. Its target is the one that the sender uses, which may be 0 for all, or another number for the
  vehicle (`MavRouter.Endpoints.Owner.Renumber`). `{:refuse, answers, instead}`: it goes no further; `answers` are
  frames to the sender in the vehicle's name, and `instead` goes to the vehicle in its place, with the same target, or
  is nil. `{:answer, answers}`: it was carried out here, and goes no further.
  """
  @callback decide(Names.gateway(), sender, MavRouter.Router.vehicle_key(), Frame.t()) ::
              :forward
              | {:answer, answers :: [iodata]}
              | {:refuse, answers :: [iodata], instead :: Frame.t() | nil}

  @doc """
  Whether telemetry, input of estimators or an answer of somebody who has the permission may go to a vehicle now: not while somebody
  else is in charge of it.
  """
  @callback permits?(Names.gateway(), Principal.t(), MavRouter.Router.vehicle_key()) :: boolean

  @doc "Whether a message without a row may go to vehicles (`policy.unknown`, `policy.open`)."
  @callback open?(Names.gateway(), Principal.t(), message :: non_neg_integer) :: boolean
end
