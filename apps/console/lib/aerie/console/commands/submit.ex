defmodule Aerie.Console.Commands.Submit do
  @moduledoc """
  Gives a command from a page, through `Aerie.Control.Commands` and always in the user's name. It does not wait for
  the result: all pages get it from `Aerie.Control.Commands.recent/3`.

  The event has `"id"`, which the browser makes for each button press, `"type"`, and the parameters as texts, beside them or in
  `"fields"`. The same id again, after a reload or from a copy, is the same command: nothing is sent again, and the answer is its result.
  """

  alias Aerie.Vehicle.Command.{Error, Types}
  alias Aerie.Base.Names
  alias Aerie.Control.Commands
  alias Aerie.Control.Policy.Roles
  alias Aerie.Console.Commands.{Entry, Form}

  @doc "Gives the command. `{:invalid, type, errors}`: its parameters are wrong; `{:refused, text}`: it was refused."
  @spec give(Names.gateway(), vehicle :: String.t(), Roles.source(), event :: map()) ::
          {:ok, id :: String.t()} | {:invalid, String.t(), Form.errors()} | {:refused, String.t()}
  def give(gateway, vehicle, user, %{"id" => id, "type" => name} = event) do
    with {:ok, type} <- Types.fetch(name),
         {:ok, params} <- Form.read(type, Map.merge(event, fields(event))) do
      envelope = %{"id" => id, "vehicle" => vehicle, "type" => name, "params" => params}
      gateway |> Commands.submit(envelope, user, via: "console", wait_ms: 0) |> answer()
    else
      :error -> {:refused, "this command does not exist"}
      {:error, errors} -> {:invalid, name, errors}
    end
  end

  def give(_gateway, _vehicle, _user, _event), do: {:refused, "a command needs an id and a type"}

  defp fields(%{"fields" => %{} = fields}), do: fields
  defp fields(_event), do: %{}

  defp answer({:pending, id}), do: {:ok, id}

  defp answer({:ok, %{status: status, reason: reason}}) when status in [:denied, :rejected],
    do: {:refused, Entry.advice(reason)}

  defp answer({:ok, %{id: id}}), do: {:ok, id}
  defp answer({:error, errors}), do: {:refused, Entry.advice(Error.text(errors))}
end
