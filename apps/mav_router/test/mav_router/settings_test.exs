defmodule MavRouter.SettingsTest do
  @moduledoc "What is wrong with several keys of a part of the router together."
  use ExUnit.Case, async: true

  alias Aerie.Base.Settings
  alias MavRouter.{Identity, Link, Recorder, Signing}
  alias MavRouter.Client
  alias MavRouter.Link.Spec
  alias Aerie.Base.Settings.{Field, Schema, Types}

  @parts [Identity.Settings, Link.Settings, Client.Settings, Signing.Settings, Recorder.Settings]

  # A configuration as a part's rules see it: checked, with defaults and specs.
  defp config(raw) do
    {config, []} = Schema.validate(Settings.fields(@parts), Schema.plain(raw))

    links =
      for link <- config.links do
        {:ok, spec} = Spec.parse(link.url, id: link.id)
        Map.merge(link, %{id: spec.id, spec: spec})
      end

    %{config | links: links}
  end

  defp problems(part, raw) do
    for problem <- part.problems(config(raw)), do: "#{Enum.join(problem.path, ".")}: #{problem.expected}"
  end

  test "the defaults are fine" do
    for part <- @parts, do: assert({[], []} = {part.problems(config(%{})), part.warnings(config(%{}))})
  end

  test "ids: auto is for gateways aboard, 255 for the ground station (H5)" do
    assert ["mavlink.system_id: a number, or vehicle_id" <> _] =
             problems(Identity.Settings, %{mavlink: %{system_id: "auto"}})

    assert [] = problems(Identity.Settings, %{vehicle_id: "A", mavlink: %{system_id: "auto"}})

    assert ["mavlink.system_id: an id that no" <> _] =
             problems(Identity.Settings, %{mavlink: %{system_id: "255"}})

    assert ["mavlink.heartbeat_type: onboard" <> _] =
             problems(Identity.Settings, %{mavlink: %{heartbeat_type: :gcs}})

    assert [] = problems(Identity.Settings, %{mavlink: %{heartbeat_type: :gcs, i_am_the_gcs: true}})
  end

  test "links: ids, addresses, limits, rules, cables" do
    link = &%{id: &1, url: &2}
    same = [link.("a", "udpin:0.0.0.0:14550"), link.("a", "udpin:0.0.0.0:14550")]

    assert [
             "links: at most limits.max_links (1)",
             "links: link ids that differ",
             "links: addresses to listen on" <> _
           ] =
             problems(Link.Settings, %{links: same, limits: %{max_links: 1}})

    secure = [Map.put(link.("a", "udpin:0.0.0.0:14550"), :secure, true)]
    assert ["links.0.secure: true for a cable" <> _] = problems(Link.Settings, %{links: secure})
    unknown = [Map.put(link.("a", "udpin:0.0.0.0:1"), :rate_limits, %{"NO_SUCH" => 1})]
    assert ["links.0: rules that make sense"] = problems(Link.Settings, %{links: unknown})
    assert ["serial.bauds: 1 to 20 baud rates"] = problems(Link.Settings, %{serial: %{bauds: []}})
    ports = for n <- 1..17, do: "ttyS#{n}"
    assert ["serial.ports: 16 ports at most"] = problems(Link.Settings, %{serial: %{ports: ports}})
  end

  test "clients: ids, limits, rules, offsets; a signing server for everybody is warned about" do
    client = &Map.merge(%{id: "c", url: "tcpin:0.0.0.0:5760"}, &1)

    assert ["clients: ids that differ" <> _, "clients: at most limits.max_clients (1)"] =
             problems(Client.Settings, %{clients: [client.(%{}), client.(%{})], limits: %{max_clients: 1}})

    assert ["clients.0: rules that make sense"] =
             problems(Client.Settings, %{clients: [client.(%{url: "replay:a.tlog"})]})

    shown = %{
      clients: [client.(%{id_offsets: %{"main" => 10}})],
      signing: %{keys: [%{network: "main", key_env: "K"}]}
    }

    assert ["clients.0.id_offsets: networks without signing keys"] = problems(Client.Settings, shown)

    open = config(%{clients: [client.(%{sign: true})]})
    assert ["clients c: sign: true for a server" <> _] = Client.Settings.warnings(open)
    own = config(%{clients: [client.(%{sign: true, url: "tcpin:127.0.0.1:5760"})]})
    assert Client.Settings.warnings(own) == []
  end

  test "signing: one source for each key, one key for each vehicle, weak policies are warned about" do
    key = &Map.merge(%{network: "main", system_id: 1}, &1)
    both = %{signing: %{keys: [key.(%{key_file: "a", key_env: "B"}), key.(%{key_env: "C", policy: :off})]}}

    assert ["signing.keys.0: one of key_file and key_env", "signing.keys: one key for each network" <> _] =
             problems(Signing.Settings, both)

    assert ["signing.keys: a policy other than required is UNSAFE" <> _] =
             Signing.Settings.warnings(config(both))
  end

  test "recordings: no file is larger than all of them" do
    assert ["recorder.max_file_mb: at most recorder.max_mb (1.0)"] =
             problems(Recorder.Settings, %{recorder: %{max_mb: 1, max_file_mb: 2}})
  end

  test "names, ids, addresses and origins" do
    parse = fn {:parse, parse, _words}, text -> parse.(text) end
    assert {:ok, "a-B_9"} = parse.(Types.token(), "a-B_9")
    for bad <- ["", "a b", "a.b", String.duplicate("a", 65)], do: assert(:error = parse.(Types.token(), bad))
    assert {:ok, :auto} = parse.(Types.system_id(), "auto")
    assert {:ok, 7} = parse.(Types.system_id(), "7")
    for bad <- ["0", "4294967296", "7a"], do: assert(:error = parse.(Types.system_id(), bad))
    assert {:ok, "::1"} = parse.(Types.ip(), "::1")
    assert :error = parse.(Types.ip(), "localhost")
    assert {:ok, "gcs.example.org"} = parse.(Types.host(), "GCS.example.org")
    assert :error = parse.(Types.host(), "a b")
    assert {:ok, "https://gcs.example.org"} = parse.(Types.origin(), "https://GCS.example.org")

    for bad <- ["gcs.example.org", "https://gcs.example.org/x"],
        do: assert(:error = parse.(Types.origin(), bad))

    assert {:ok, :off} = parse.(Types.listen_address(), "off")

    for type <- [
          Types.token(),
          {:list, :path},
          {:one_or_list, :boolean},
          {:map, {:number, 0, 1}},
          {:section, []}
        ],
        do: assert(String.length(Field.expected(type)) > 10)
  end
end
