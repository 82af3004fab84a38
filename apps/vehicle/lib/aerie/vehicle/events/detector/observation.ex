defmodule Aerie.Vehicle.Events.Detector.Observation do
  @moduledoc """
  Something observed of a vehicle that may be an event, on its way from the session to the detector.

  | kind          | data                                        | events                                                  |
  |---------------|---------------------------------------------|---------------------------------------------------------|
  | `:state`      | a digest (`Detector.Digest`) and what is beside it | mode_change, armed, disarmed, takeoff, landed, failsafe, geofence, battery, rc, gps, position, mission.completed |
  | `:text`, `:part_text` | `%{severity: 0..7, text: text}`, and of a part `component` | statustext; of the autopilot failsafe, gcs_failsafe, geofence, rc, kill_switch, mission.completed if the text says so |
  | `:report`     | the data of the event                       | report                                                  |
  | `:px4_report` | `%{name: name, values: values, where: position}` | failsafe, gcs_failsafe, rc, kill_switch (`Detector.Failsafe.Px4Reports`) |
  | `:settle`     | the position                                | failsafe, when the time for its cause is over           |
  | `:reached`    | the item's number                           | mission.reached                                         |
  | `:params`     | `[{name, value, index}]`                    | param_changed                                           |
  | `:lost`       | the silence (us)                            | link.lost                                               |
  | `:restored`   |                                             | link.restored                                           |
  | `:unheard`    | when it was last heard (us)                 | link.lost: known before the gateway was started, not heard since |
  | `:reboot`     |                                             | reboot                                                  |
  | `:collision`  | `%{sign: sign, links: links}`               | collision                                               |
  | `:streams`    | notices of `Streams.Arbiter`                | stream.contested                                        |
  | `:gcs`        | `{:lost or :back, facts}` of `Services.Gcs` | gcs.lost, gcs.restored                                  |
  | `:external`   | `%{type: type, data: data}`                 | found by another part of the gateway: signing.*, displaced |
  | `:published`  | what was published before the restart       | mode_change, armed, disarmed, takeoff, landed (`Detector.OfflineChanges`) |
  | `:quiet`      |                                             | none: nothing was observed for a while                  |

  `events.suppressed` may come with any of them (`Detector.Budget`).
  """

  @enforce_keys [:kind, :at, :boot_ms]
  defstruct [:kind, :at, :boot_ms, :data, :received]

  @type kind ::
          :state
          | :text
          | :part_text
          | :report
          | :px4_report
          | :settle
          | :reached
          | :params
          | :lost
          | :restored
          | :unheard
          | :reboot
          | :collision
          | :streams
          | :gcs
          | :external
          | :published
          | :quiet

  @typedoc """
  - `at`: when it happened, unix us; `boot_ms`: the same by the vehicle's clock, or nil
  - `received`: when the gateway learned of it, unix us; a report may come up to an hour late
  """
  @type t :: %__MODULE__{
          kind: kind(),
          at: integer(),
          boot_ms: non_neg_integer() | nil,
          data: term(),
          received: integer()
        }

  @spec new(kind(), integer(), non_neg_integer() | nil, term(), received :: integer() | nil) :: t()
  def new(kind, at, boot_ms, data \\ nil, received \\ nil),
    do: %__MODULE__{kind: kind, at: at, boot_ms: boot_ms, data: data, received: received || at}
end
