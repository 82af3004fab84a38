defmodule Aerie.Victims do
  @moduledoc "The processes of a gateway that has a VM of its own, for a test that ends each of them. Called in that VM."

  alias Aerie.Base.Store

  @apps [
    :aerie,
    :base,
    :mav_router,
    :vehicle,
    :control,
    :fleet,
    :access,
    :api,
    :console,
    :telemetry,
    :ranch,
    :cowboy
  ]

  @doc "The port of HTTP, nil while it does not listen."
  @spec port() :: :inet.port_number() | nil
  def port do
    Aerie.Api.Listener.port(:default)
  rescue
    _restarting -> nil
  end

  @doc "When its vehicle was heard last, in µs; 0 while it is not known."
  @spec heard_at() :: integer()
  def heard_at do
    [%{last_heard: at}] = Store.vehicles(:default)
    at
  rescue
    _restarting -> 0
  end

  @doc "Each with a name that its successor has as well."
  @spec processes() :: [{String.t(), pid()}]
  def processes do
    for pid <- Process.list(),
        {_key, [_ | _] = ancestors} <- [:erlang.process_info(pid, {:dictionary, :"$ancestors"})],
        app = :application.get_application(pid),
        match?({:ok, app} when app in @apps, app) or logs?(pid),
        not of_otp?([pid | Enum.take(ancestors, 1)]),
        do: {name(pid), pid}
  end

  # The masters of applications, and the top process of each.
  defp of_otp?(pids) do
    Enum.any?(
      pids,
      &(is_pid(&1) and
          Enum.any?([:proc_lib.translate_initial_call(&1), initial(&1)], fn {m, _, _} ->
            m == :application_master
          end))
    )
  end

  defp initial(pid) do
    with {:initial_call, call} <- Process.info(pid, :initial_call), do: call, else: (nil -> {nil, nil, 0})
  end

  defp logs?(pid), do: Process.info(pid, :registered_name) == {:registered_name, :logger_std_h_default}

  defp name(pid) do
    registered = with {:registered_name, name} <- Process.info(pid, :registered_name), do: name
    roles = Aerie.Base.Names.roles(:default, pid)

    inspect(
      {registered, roles, :proc_lib.translate_initial_call(pid),
       if(roles == [], do: Process.info(pid, :label))}
    )
  end
end
