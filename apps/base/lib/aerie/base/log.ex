defmodule Aerie.Base.Log do
  @moduledoc """
  The log of the gateway: its format (`Aerie.Base.Log.Settings`, `Aerie.Base.Log.Formatter`) and its levels, which can be changed while the
  gateway runs.

      Aerie.Base.Log.set_level(:debug)                    # everything
      Aerie.Base.Log.set_level("mav_router", :debug)      # links, routing, signing, recorder
      Aerie.Base.Log.reset("mav_router")
      Aerie.Base.Log.levels()

  The log belongs to the VM: several gateways in one VM share it. A restart brings the configured level back.
  """

  alias Aerie.Base.Log.{Formatter, Settings}

  @levels ~w(debug info notice warning error none)a
  # Subjects with a level of their own.
  @areas %{
    "mav_router" => [:mav_router, :base],
    "vehicle" => [:vehicle, :control, :fleet],
    "fleet_web" => [:access, :api, :console],
    "aerie" => [:aerie],
    "gnat" => [:gnat],
    "circuits_uart" => [:circuits_uart],
    "phoenix_live_view" => [:phoenix_live_view]
  }

  @type level :: :debug | :info | :notice | :warning | :error | :none

  @doc "The levels, from the most talkative on."
  @spec level_names() :: [level()]
  def level_names, do: @levels

  @doc "The areas whose level can be another one than that of everything: an application, or several."
  @spec areas() :: [String.t()]
  def areas, do: @areas |> Map.keys() |> Enum.sort()

  @doc "Has the log written in this format and from this level on."
  @spec configure(Settings.t()) :: :ok
  def configure(%Settings{level: level, format: format}) do
    set_level(level)
    # Without a handler (a program that logs elsewhere) there is nothing to format.
    _ = :logger.update_handler_config(:default, :formatter, Formatter.new(format))
    :ok
  end

  @doc "The format in use."
  @spec format() :: Formatter.format()
  def format do
    case :logger.get_handler_config(:default) do
      {:ok, %{formatter: {Formatter, %{format: format}}}} -> format
      _other -> :logfmt
    end
  end

  @doc "The level of everything, and of the areas that have one of their own."
  @spec levels() :: %{level: level(), areas: %{String.t() => level()}}
  def levels do
    own =
      for {name, [app | _others]} <- @areas,
          [module | _] <- [Application.spec(app, :modules) || []],
          [{^module, level}] <- [Logger.get_module_level(module)],
          into: %{},
          do: {name, level}

    %{level: Logger.level(), areas: own}
  end

  @doc "Logs everything from this level on; areas with a level of their own keep it."
  @spec set_level(level()) :: :ok
  def set_level(level) when level in @levels, do: Logger.configure(level: level)

  @doc "Logs an area (`areas/0`) from this level on."
  @spec set_level(String.t(), level()) :: :ok | {:error, :unknown_area}
  def set_level(area, level) when level in @levels do
    each(area, &Logger.put_application_level(&1, level))
  end

  @doc "An area follows the level of everything again."
  @spec reset(String.t()) :: :ok | {:error, :unknown_area}
  def reset(area) do
    each(area, &Logger.delete_application_level/1)
  end

  # {:error, :not_loaded}: nothing of it runs here.
  defp each(area, fun) do
    with {:ok, apps} <- Map.fetch(@areas, area),
         true <- :ok in Enum.map(apps, fun) do
      :ok
    else
      _unknown -> {:error, :unknown_area}
    end
  end
end
