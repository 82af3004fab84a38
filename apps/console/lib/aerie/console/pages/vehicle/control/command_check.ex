defmodule Aerie.Console.Pages.Vehicle.Control.CommandCheck do
  @moduledoc "The policy's and the firmware's answer to the command that is being prepared on a vehicle's page, before it is sent."

  alias Aerie.Vehicle.Command
  alias Aerie.Control.Commands
  alias Aerie.Console.Commands.{Form, Guided}
  alias Aerie.Console.Pages.Vehicle.View
  alias Aerie.Console.Pages.Vehicle.Control.Target

  @doc "The answer for the page's assigns: `:allow`, or why not; nil while the command is not complete."
  @spec of(map()) ::
          :allow | {:deny, atom(), String.t()} | {:error, [Exception.t(), ...]} | nil
  def of(%{section: "commands", command: name, view: %View{}} = assigns) when is_binary(name) do
    case Form.read(Command.type(name), assigns.form) do
      {:ok, params} -> check(assigns, name, params)
      {:error, _incomplete} -> nil
    end
  end

  def of(%{target: %{type: type} = target} = assigns) do
    [first | then] = Guided.commands(type)

    case Form.read(Command.type(first), Target.fields(target)) do
      {:ok, params} ->
        with :allow <- check(assigns, first, params),
             nil <- Enum.find_value(then, &refused(check(assigns, &1, %{}))),
             nil <- Guided.cannot(assigns.view.vehicle, type),
             do: :allow,
             else: (
               why when is_binary(why) -> {:deny, :vehicle, why}
               answer -> answer
             )

      {:error, %{fields: fields}} ->
        {:deny, :form, Enum.map_join(fields, "; ", fn {name, text} -> "#{name}: #{text}" end)}
    end
  end

  def of(_nothing), do: nil

  defp refused(answer), do: if(answer != :allow, do: answer)

  @doc """
  Why the vehicle may not be calibrated now: the policy's condition, by default disarmed and on the ground; nil if it
  may. What the user or the firmware lacks is another matter.
  """
  @spec workshop(map()) :: String.t() | nil
  def workshop(assigns) do
    case check(assigns, "calibrate", %{"sensor" => "gyro"}) do
      {:deny, :condition, reason} -> reason
      _other -> nil
    end
  end

  defp check(%{gateway: gateway, id: id, user: user}, type, params),
    do: Commands.check(gateway, vehicle: id, type: type, params: params, as: user)
end
