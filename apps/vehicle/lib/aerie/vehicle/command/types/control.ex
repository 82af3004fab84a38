defmodule Aerie.Vehicle.Command.Types.Control do
  @moduledoc "Commands about who is in charge of a vehicle: rows of `Aerie.Vehicle.Command.Types`. The gateway itself carries them out."

  alias Aerie.Vehicle.Command.{Param, Type}

  @by "the gateway: nobody else commands the vehicle"

  @doc false
  @spec rows() :: [Type.t()]
  def rows do
    [
      %Type{
        name: "take_control",
        group: :control,
        meaning:
          "Takes charge of the vehicle: from now on nobody else commands it. If somebody else is in charge, a reason is needed, unless they offered it.",
        mav_cmds: ~w(REQUEST_OPERATOR_CONTROL)a,
        permission: :fly,
        confirmed_by: @by,
        params: [
          Param.text(
            :reason,
            200,
            "why it is taken over; in the log, and shown to the source that was in charge"
          )
        ]
      },
      %Type{
        name: "hand_over_control",
        group: :control,
        meaning:
          "Offers control of the vehicle to another source. The source that offers it stays in charge until the other one takes over.",
        permission: :fly,
        confirmed_by: "the gateway: it is offered",
        params: [
          Param.text(:to, 64, "name of the source that may take it without a reason; anybody if left out")
        ]
      },
      %Type{
        name: "release_control",
        group: :control,
        meaning: "Gives up control of the vehicle. An admin may also end somebody else's control.",
        permission: :fly,
        confirmed_by: "the gateway: nobody is in charge"
      }
    ]
  end
end
