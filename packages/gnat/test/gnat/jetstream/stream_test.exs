defmodule Gnat.Jetstream.StreamTest do
  use ExUnit.Case, async: true

  import Gnat.Test

  alias Gnat.Jetstream.API.Stream
  alias Gnat.Test.NatsServer

  setup_all do
    server = start_supervised!({NatsServer, jetstream: true})
    {:ok, server: server}
  end

  setup %{server: server} do
    {:ok, gnat} = Gnat.start_link(NatsServer.settings(server, %{no_responders: true}))
    name = unique("S")
    {:ok, gnat: gnat, name: name, stream: %Stream{name: name, subjects: [name <> ".>"]}}
  end

  describe "streams" do
    test "are created as configured, and described", %{gnat: gnat, name: name, stream: stream} do
      stream = %{
        stream
        | storage: :memory,
          discard: :new,
          retention: :interest,
          max_msgs_per_subject: 1,
          max_age: 60_000_000_000,
          duplicate_window: 5_000_000_000,
          description: "a test"
      }

      assert {:ok, %{config: config, state: state, created: %DateTime{}}} = Stream.create(gnat, stream)
      assert %Stream{name: ^name, storage: :memory, discard: :new, retention: :interest} = config
      assert %{max_msgs_per_subject: 1, max_age: 60_000_000_000, duplicate_window: 5_000_000_000} = config
      assert %{description: "a test", subjects: [_]} = config
      assert %{messages: 0, bytes: 0, first_seq: _, last_seq: 0, consumer_count: 0} = state

      assert {:ok, %{config: ^config}} = Stream.info(gnat, name)
    end

    test "can be created twice with the same configuration, not with another", %{gnat: gnat, stream: stream} do
      assert {:ok, _} = Stream.create(gnat, stream)
      assert {:ok, _} = Stream.create(gnat, stream)

      assert {:error, %{"err_code" => 10_058, "description" => _}} =
               Stream.create(gnat, %{stream | max_msgs: 7})

      assert {:ok, %{config: %{max_msgs: 7}}} = Stream.update(gnat, %{stream | max_msgs: 7})
    end

    test "are listed, by subject too", %{gnat: gnat, name: name, stream: stream} do
      {:ok, _} = Stream.create(gnat, stream)
      assert {:ok, %{streams: streams, total: total, offset: 0, limit: _}} = Stream.list(gnat)
      assert name in streams and total >= 1
      assert {:ok, %{streams: [^name]}} = Stream.list(gnat, subject: name <> ".a")
      assert {:ok, %{streams: []}} = Stream.list(gnat, subject: "nobody.keeps.this")
    end

    test "are deleted", %{gnat: gnat, name: name, stream: stream} do
      {:ok, _} = Stream.create(gnat, stream)
      assert :ok = Stream.delete(gnat, name)
      assert {:error, %{"code" => 404, "description" => "stream not found"}} = Stream.info(gnat, name)
    end

    test "give single messages", %{gnat: gnat, name: name, stream: stream} do
      {:ok, _} = Stream.create(gnat, stream)
      topic = name <> ".a"
      {:ok, _} = store(gnat, topic, "first")
      {:ok, _} = store(gnat, topic, <<0, 255>>, [{"x", "1"}])

      assert {:ok, %{data: "first", seq: 1, subject: ^topic, time: %DateTime{}, hdrs: nil}} =
               Stream.get_message(gnat, name, %{seq: 1})

      assert {:ok, %{data: <<0, 255>>, seq: 2, hdrs: "NATS/1.0\r\n" <> _}} =
               Stream.get_message(gnat, name, %{last_by_subj: topic})

      assert {:error, %{"code" => 404}} = Stream.get_message(gnat, name, %{seq: 9})
    end

    test "with invalid names or subjects are refused locally", %{gnat: gnat, stream: stream} do
      for name <- ["a.b", "a b", "a*", "a>", "", "a\r\nPUB x 0\r\n"] do
        assert {:error, text} = Stream.create(gnat, %{stream | name: name})
        assert text =~ "name"
        assert {:error, _} = Stream.delete(gnat, name)
      end

      assert {:error, "name must be a string"} = Stream.info(gnat, nil)
      assert {:error, ":subjects must be" <> _} = Stream.create(gnat, %{stream | subjects: "a"})
    end
  end
end
