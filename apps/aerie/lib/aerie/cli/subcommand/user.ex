defmodule Aerie.CLI.Subcommand.User do
  @moduledoc "`aerie user add`, `list` and `remove`: the users of a running gateway's console."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Output.Columns
  alias Aerie.Access.Users

  @impl Aerie.CLI.Subcommand
  def run(%{name: "user add", arguments: %{"NAME" => name}, options: options}) do
    case IO.gets("password: ") do
      text when is_binary(text) ->
        done(
          fn ->
            Users.add(:default, name, options[:role] || "operator", String.trim_trailing(text, "\n"), "aerie")
          end,
          "added #{name}"
        )

      _nothing ->
        {:error, "no password: it is the first line of standard input"}
    end
  end

  def run(%{name: "user remove", arguments: %{"NAME" => name}}),
    do: done(fn -> Users.remove(:default, name, "aerie") end, "removed #{name}")

  def run(%{name: "user list"}),
    do: {0, Columns.render(~w(NAME ROLE PERMISSIONS), for(user <- Users.list(:default), do: shown(user)))}

  defp shown(user), do: [user.name, user.role, Enum.join(user.permissions, ", ")]

  defp done(fun, text) do
    with :ok <- fun.(), do: {0, text <> "\n"}
  catch
    :exit, _no_process -> {:error, "this gateway has no console (http.enabled, console.enabled)"}
  end
end
