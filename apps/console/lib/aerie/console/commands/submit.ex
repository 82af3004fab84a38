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

  @typedoc "What became of a command, with a text for a page."
  @type state :: :under_way | {:done, atom(), text :: String.t() | nil}

  @doc "Gives the command. `{:invalid, type, errors}`: its parameters are wrong."
  @spec give(Names.gateway(), vehicle :: String.t(), Roles.source(), event :: map()) ::
          state() | {:invalid, String.t(), Form.errors()}
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
