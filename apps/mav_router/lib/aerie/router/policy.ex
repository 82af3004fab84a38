defmodule Aerie.Router.Policy do
  @moduledoc """
  The module that decides which commands of clients reach a vehicle, given to `Aerie.Router.Supervisor` (`:policy`). Without one
  every endpoint that may command (`Aerie.Router.CommandGate`) may send every command.

  It is asked for messages of `Aerie.Router.ControlMessages` that a vehicle would obey, from endpoints where no autopilot is
  heard; never for telemetry. It runs in the process that received the frame: it must not wait.
  """

  alias Aerie.Names
  alias MavCodec.Frame

  @typedoc "Who sends: the endpoint, its client or link, and its address in words."
  @type sender :: %{endpoint: Aerie.Router.Endpoint.key(), owner: String.t(), peer: String.t() | nil}

  @doc """
  A frame on its way to a vehicle. Its target is the one that the sender uses, which may be 0 for all, or another number for the
  vehicle (`Aerie.Router.Renumber`). `{:refuse, answers, instead}`: it goes no further; `answers` are frames to the sender in
  the vehicle's name, and `instead` goes to the vehicle in its place, with the same target, or is nil. `{:answer, answers}`: it
  was carried out here, and goes no further.
  """
  @callback decide(Names.gateway(), sender, Aerie.Router.vehicle_key(), Frame.t()) ::
              :forward
              | {:answer, answers :: [iodata]}
              | {:refuse, answers :: [iodata], instead :: Frame.t() | nil}
end
