defmodule Aerie.Console.Commands.Submit do
  @moduledoc """
  Gives a command from a page, through `Aerie.Control.Commands` and always in the user's name. It does not wait for
  the result: all pages get it from `Aerie.Control.Commands.recent/3`.

  The event has `"id"`, which the browser makes for each button press, `"type"`, and the parameters as texts, beside
  them or in `"fields"`. The same id again, after a reload or from a copy, is the same command: nothing is sent again,
  and the answer is its result.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Base.Names
  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Commands.Form
  alias Aerie.Fleet

  @typedoc "What became of a command, with a text for a page."
  @type state :: :under_way | {:done, atom(), text :: String.t() | nil}

  @doc """
  Gives the command. `{:invalid, type, errors}`: its parameters are wrong. `land_here` is an operation of the gateway,
  which goes on without the page; its press names the vehicle.
  """
  @spec give(Names.gateway(), vehicle :: String.t(), Roles.source(), event :: map()) ::
          state() | {:invalid, String.t(), Form.errors()}
  def give(gateway, vehicle, user, %{"id" => id, "type" => "land_here", "vehicle" => vehicle} = event) do
    with {:ok, goto} <- Form.read(Command.type("goto"), Map.merge(event, fields(event))),
         %{} = seen <- Fleet.vehicle(gateway, vehicle),
         {:ok, steps} <- Fleet.land_at(seen, goto),
         request = %{"id" => id, "name" => "Land here", "sequence" => [steps]},
         {:begun, {:ok, _operation}} <- {:begun, Fleet.begin_operation(gateway, request, user, "console")} do
      :under_way
    else
      nil -> {:done, :rejected, "nobody hears the vehicle"}
      {:begun, {:error, refusal}} -> {:done, :rejected, Fleet.refusal(refusal)}
      {:error, <<why::binary>>} -> {:done, :rejected, why}
      {:error, errors} -> {:invalid, "goto", errors}
    end
  end

  def give(gateway, vehicle, user, %{"id" => id, "type" => name} = event) do
    with %{} = type <- Command.type(name),
         {:ok, params} <- Form.read(type, Map.merge(event, fields(event))) do
      envelope = %{"id" => id, "vehicle" => vehicle, "type" => name, "params" => params}

      case Commands.submit(gateway, envelope, user, via: "console", wait_ms: 0) do
        {:pending, _id} -> :under_way
        {:ok, result} -> state(result)
        {:error, errors} -> {:done, :rejected, Enum.join(errors, "; ")}
      end
    else
      nil -> {:done, :rejected, "this command does not exist"}
      {:error, errors} -> {:invalid, name, errors}
    end
  end

  def give(_gateway, _vehicle, _user, _event), do: {:done, :rejected, "a command needs an id and a type"}

  defp fields(%{"fields" => %{} = fields}), do: fields
  defp fields(_event), do: %{}

  @doc "Errors in one line."
  @spec text(Form.errors()) :: String.t()
  def text(%{fields: fields, general: general}),
    do: Enum.join(Enum.map(fields, fn {name, text} -> "#{name}: #{text}" end) ++ general, "; ")

  @doc "The state of a command that has its result."
  @spec state(map()) :: state()
  def state(%{status: status, reason: reason}), do: {:done, status, reason && Command.on_pages(reason)}
end
