defmodule MavRouter.Forward.Delivery do
  @moduledoc """
  The frames of one component in one read, on their way through the router: who sent them, and by which path they came.

  | field | |
  |---|---|
  | `gateway`, `tables` | whose router it is, and its tables |
  | `forwarding` | all paths, as the forwarding process knows them |
  | `path` | the endpoint that the frames came from, with the rules of its owner |
  | `frames` | its frames, as far as no station has kept or answered them |
  | `trusted` | those of the read whose signature was right, or that need none: only from them anything is learned |
  | `source` | the component that sent them; nil when the read has frames of several |
  | `now` | monotonic ms |
  | `sender` | their origin, as the vehicle's session hears it: the id of the link, or the endpoint's key while several endpoints bring the system |
  | `vehicle` | whether one of the frames was the heartbeat of a vehicle's autopilot |
  | `secure` | whether the link is a cable that the operator vouches for (`secure: true`) |
  | `scope` | whom the frames may reach (`MavRouter.Forward.Gate`): clients only, unless the gate says more |
  """

  alias MavRouter.Forward.Table
  alias MavRouter.Forward.Source
  alias MavRouter.Tables

  @enforce_keys [:gateway, :tables, :forwarding, :path, :now]
  defstruct [:gateway, :tables, :forwarding, :path, :source, :now, :sender] ++
              [frames: [], trusted: [], secure: false, vehicle: false, scope: :clients]

  @type t :: %__MODULE__{
          gateway: Aerie.Base.Names.gateway(),
          tables: Tables.t(),
          forwarding: Table.t(),
          path: Table.Path.t(),
          frames: [MavCodec.Frame.t()],
          trusted: [MavCodec.Frame.t()],
          source: Source.t() | nil,
          now: integer,
          sender: String.t() | MavRouter.Endpoints.Endpoint.key() | nil,
          secure: boolean,
          vehicle: boolean,
          scope: :cleared | :clients | :related
        }
end
