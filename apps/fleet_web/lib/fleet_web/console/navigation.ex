defmodule FleetWeb.Console.Navigation do
  @moduledoc "The entries of the navigation, in order."

  alias Aerie.Control.Policy.Roles

  @typedoc """
    * `path` - the page's path; the entry is also current for paths below it
    * `icon` - a name of `FleetWeb.Console.UI.Icon`
    * `key` - the letter that opens the page, after `g`
    * `role` - the lowest role that sees it
    * `main` - whether a phone shows it in the bar; the others are in the menu
  """
  @type entry :: %{
          path: String.t(),
          label: String.t(),
          icon: String.t(),
          key: String.t(),
          role: Roles.role(),
          main: boolean()
        }

  @entries [
    %{path: "/", label: "Fleet", icon: "map", key: "f", role: :viewer, main: true},
    %{path: "/plan", label: "Plan", icon: "plan", key: "p", role: :viewer, main: true},
    %{path: "/params", label: "Parameters", icon: "params", key: "m", role: :viewer, main: false},
    %{path: "/alarms", label: "Alarms", icon: "bell", key: "a", role: :viewer, main: true},
    %{path: "/links", label: "Links", icon: "link", key: "l", role: :viewer, main: false},
    %{path: "/inspector", label: "Inspector", icon: "inspector", key: "i", role: :viewer, main: false},
    %{path: "/recordings", label: "Recordings", icon: "record", key: "r", role: :viewer, main: false},
    %{path: "/diagnosis", label: "Diagnosis", icon: "diagnosis", key: "d", role: :viewer, main: false},
    %{path: "/system", label: "System", icon: "system", key: "y", role: :viewer, main: false},
    %{path: "/audit", label: "Audit", icon: "audit", key: "u", role: :operator, main: false},
    %{path: "/settings", label: "Settings", icon: "settings", key: "s", role: :viewer, main: false}
  ]

  @doc "The entries for a role."
  @spec entries(Roles.role()) :: [entry()]
  def entries(role), do: Enum.filter(@entries, &FleetWeb.Console.Access.Role.at_least?(role, &1.role))

  @doc "Whether an entry is the page at a path, or above it."
  @spec current?(entry(), String.t()) :: boolean()
  def current?(%{path: "/"}, path), do: path == "/"
  def current?(%{path: own}, path), do: path == own or String.starts_with?(path, own <> "/")
end
