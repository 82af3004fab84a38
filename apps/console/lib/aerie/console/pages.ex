defmodule Aerie.Console.Pages do
  @moduledoc """
  The pages of the console, one row each, from which the router and the navigation are made. A page says itself which role sees it
  (`use Aerie.Console, {:page, role: …}`).
  """

  alias Aerie.Console.Pages
  alias Aerie.Control.Policy.Roles

  @typedoc """
    * `path` - the page's path; its entry is also current for paths below it
    * `page` - its LiveView
    * `label` - its name in the navigation; nil for a page that has no entry
    * `icon` - a name of `Aerie.Console.UI.Icon`
    * `key` - the letter that opens the page, after `g`
    * `main` - whether a phone shows it in the bar; the others are in the menu
    * `gateway` - whether it is about the gateway and not about vehicles
  """
  @type row :: %{
          path: String.t(),
          page: module(),
          label: String.t() | nil,
          icon: String.t() | nil,
          key: String.t() | nil,
          main: boolean(),
          gateway: boolean()
        }

  rows = [
    {"/", Pages.Fleet.Page, "Fleet", "map", "f", true},
    {"/vehicles/:id", Pages.Vehicle.Page, nil, nil, nil, false},
    {"/vehicles/:id/shadow", Pages.Shadow.Page, nil, nil, nil, false},
    {"/vehicles/:id/:section", Pages.Vehicle.Page, nil, nil, nil, false},
    {"/plan", Pages.Plan.Page, "Plan", "plan", "p", true},
    {"/params", Pages.Params.Page, "Parameters", "params", "m", false},
    {"/alarms", Pages.Alarms.Page, "Alarms", "bell", "a", true},
    {"/events", Pages.Events.Page, "Events", "list", "e", false},
    {"/replay", Pages.Replay.Page, "Replay", "restart", "t", false},
    {"/links", Pages.Links.Page, "Links", "link", "l", false},
    {"/inspector", Pages.Inspector.Page, "Inspector", "inspector", "i", false},
    {"/recordings", Pages.Recordings.Page, "Recordings", "record", "r", false},
    {"/diagnosis", Pages.Diagnosis.Page, "Diagnosis", "diagnosis", "d", false},
    {"/system", Pages.System.Page, "System", "system", "y", false},
    {"/audit", Pages.Audit.Page, "Audit", "audit", "u", false},
    {"/settings", Pages.Settings.Page, "Settings", "settings", "s", false}
  ]

  @gateway ~w(/links /inspector /diagnosis /system /audit /settings)

  @rows for {path, page, label, icon, key, main} <- rows,
            do: %{
              path: path,
              page: page,
              label: label,
              icon: icon,
              key: key,
              main: main,
              gateway: path in @gateway
            }

  @doc "All pages; the first path that matches counts."
  @spec all() :: [row()]
  def all, do: @rows

  @doc "The entries of the navigation for a role, in order."
  @spec entries(Roles.role()) :: [row()]
  def entries(role),
    do:
      for(
        %{label: label, page: page} = row <- @rows,
        label != nil,
        Roles.at_least?(role, page.__console__().role),
        do: row
      )

  @doc "Whether an entry is the page at a path, or above it."
  @spec current?(row(), String.t()) :: boolean()
  def current?(%{path: "/"}, path), do: path == "/"
  def current?(%{path: own}, path), do: path == own or String.starts_with?(path, own <> "/")
end
