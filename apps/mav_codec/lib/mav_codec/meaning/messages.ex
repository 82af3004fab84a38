defmodule MavCodec.Meaning.Messages do
  @moduledoc """
  What each message does to a vehicle that gets it, and who may send it there: one row for every message of the
  definitions. A message without a row reaches no vehicle. A test compares the rows with the definitions, so that a new
  message waits until somebody decides about it.

  | column | |
  |---|---|
  | `class` | see below |
  | `permission` | what a client, key or user needs so that the message goes to a vehicle; nil: theirs never does |
  | `crosses` | whether another vehicle's goes to a vehicle: `:never`, `:always`, or `:team` (only with `router.between_vehicles: all`) |
  | `limited` | whether a client needs `inputs` as well where a fence or a limit of height is configured |
  | `part` | whether one of a part of the vehicle (a camera, a gimbal, a companion) goes to its autopilot, by a link with `parts: true` |
  | `order?` | whether a vehicle obeys or keeps it, which follows from the class; the policy judges orders one by one |
  | `per_minute` | how often the gateway asks a vehicle for somebody who may not ask it himself, for each such client; 0: never |

  | class | |
  |---|---|
  | `:telemetry` | what a sender says of itself |
  | `:presence` | heartbeats, which failsafes listen to |
  | `:question` | requests whose answer changes nothing; times |
  | `:answer` | acknowledgements |
  | `:input` | what estimators, clocks, flow control and safety functions believe |
  | `:stick` | a pilot's controls |
  | `:setpoint` | where to go, how fast, in which attitude |
  | `:command` | commands by number (see `MavCodec.Meaning.Commands`) and by messages of their own |
  | `:parameter`, `:mission`, `:file` | writes of these; missions and files go both ways |
  | `:internal` | what firmwares and buses say among themselves |

  Some telemetry has a permission, because a firmware acts upon it when somebody else sends it: PX4 takes RC_CHANNELS
  for a pilot's sticks and BATTERY_STATUS for its battery, ArduPilot follows GLOBAL_POSITION_INT. Sources: PX4's
  `mavlink_receiver.cpp` and ArduPilot's `GCS_Common.cpp`.
  """

  alias MavCodec.Meaning.Messages.Rows

  @enforce_keys [:class]
  defstruct [:class, :permission, limited: false, crosses: :never, part: false, per_minute: 0, order?: false]

  # Messages that a vehicle obeys or stores. The others report, request, or inform.
  @orders [:stick, :setpoint, :command, :parameter, :mission, :file, :internal]

  @type class ::
          :telemetry
          | :presence
          | :question
          | :answer
          | :input
          | :stick
          | :setpoint
          | :command
          | :parameter
          | :mission
          | :file
          | :internal

  @type row :: %__MODULE__{
          class: class(),
          permission: atom() | nil,
          limited: boolean(),
          crosses: :never | :team | :always,
          part: boolean(),
          per_minute: non_neg_integer(),
          order?: boolean()
        }

  rows =
    for {id, fields} <- Rows.all() do
      {id, fields |> Map.new() |> Map.put(:order?, fields[:class] in @orders)}
    end

  @doc "The row of a message; nil for one that has none."
  @spec row(non_neg_integer()) :: row() | nil
  for {id, fields} <- rows do
    def row(unquote(id)), do: %__MODULE__{unquote_splicing(Map.to_list(fields))}
  end

  def row(_unknown), do: nil

  @doc "Whether a message is an order: something that a vehicle obeys or keeps. A message without a row is not."
  @spec order?(non_neg_integer()) :: boolean()
  for {id, %{order?: true}} <- rows, do: def(order?(unquote(id)), do: true)
  def order?(_other), do: false
end
