// Short and long frames on one channel: 802.11a, DCF without RTS. Saturated senders send UDP-size packets
// to one sink; those with even numbers send short packets, those with odd numbers long ones. Free-space
// path loss at 5180 MHz, 16 dBm, noise figure 7 dB, NIST error model, no capture model, seven transmissions
// of a frame.
// --layout=centre: senders on a circle, the sink in its centre. --layout=ring: senders and sink on one
// circle.
// --undetected sets ns-3's CcaSensitivity, from which a frame makes the medium busy whose preamble a
// station has not received because it was sending or receiving; by default the -82 dBm of ns-3. (In 3.37
// the same threshold also holds after a frame with an unreadable header, so that -62 dBm is not the
// standard's rule either.)
// Prints layout, senders, radius_m, mode, short_bytes, long_bytes, undetected_dbm, run, seconds, received
// payload of short and of long packets in Mbit/s, and of both kinds the transmissions without
// acknowledgement and the packets dropped at the retry limit.
#include "network.h"

#include <memory>

using namespace reference;

int
main(int argc, char* argv[])
{
    uint32_t senders = 10;
    double radiusM = 50.0;
    std::string layout = "centre";
    std::string mode = "OfdmRate6Mbps";
    uint32_t shortBytes = 50;
    uint32_t longBytes = 2000;
    double undetectedDbm = -82.0;
    double seconds = 60.0;
    bool timeline = false;
    CommandLine command(__FILE__);
    command.AddValue("senders", "saturated stations", senders);
    command.AddValue("radius", "radius of the circle, m", radiusM);
    command.AddValue("layout", "centre or ring: position of the sink", layout);
    command.AddValue("mode", "mode of data frames", mode);
    command.AddValue("short", "payload of short packets, B", shortBytes);
    command.AddValue("long", "payload of long packets, B", longBytes);
    command.AddValue("undetected", "threshold for frames without received preamble, dBm", undetectedDbm);
    command.AddValue("seconds", "measured time", seconds);
    command.AddValue("timeline", "print transmissions", timeline);
    command.Parse(argc, argv);

    Config::SetDefault("ns3::WifiPhy::CcaSensitivity", DoubleValue(undetectedDbm));
    WifiSettings settings;
    settings.dataMode = mode;
    NodeContainer nodes(senders + 1);
    auto positions = Circle(layout == "ring" ? senders + 1 : senders, radiusM);
    positions->Add(Vector(0.0, 0.0, 10.0));
    auto loss = CreateObject<FriisPropagationLossModel>();
    loss->SetFrequency(5180e6);
    auto devices = InstallWifi(settings, nodes, loss, positions);
    if (timeline)
    {
        PrintTransmissions(devices);
    }

    Sink sink(devices.Get(senders));
    std::vector<std::unique_ptr<SaturatedSender>> traffic;
    for (uint32_t i = 0; i < senders; i++)
    {
        traffic.push_back(std::make_unique<SaturatedSender>(devices.Get(i),
                                                            devices.Get(senders)->GetAddress(),
                                                            i % 2 ? longBytes : shortBytes,
                                                            2));
    }
    Simulator::Schedule(Seconds(1), [&] {
        sink.Reset();
        for (auto& sender : traffic)
        {
            sender->Reset();
        }
    });
    Simulator::Stop(Seconds(1 + seconds));
    Simulator::Run();

    uint64_t timedOut[2] = {};
    uint64_t dropped[2] = {};
    for (uint32_t i = 0; i < senders; i++)
    {
        timedOut[i % 2] += traffic[i]->timedOut;
        dropped[i % 2] += traffic[i]->dropped;
    }
    std::cout << layout << "," << senders << "," << radiusM << "," << mode << "," << shortBytes << ","
              << longBytes << "," << undetectedDbm << "," << RngSeedManager::GetRun() << "," << seconds << ","
              << sink.PayloadMbps(shortBytes, seconds) << "," << sink.PayloadMbps(longBytes, seconds) << ","
              << timedOut[0] << "," << timedOut[1] << "," << dropped[0] << "," << dropped[1] << std::endl;
    Simulator::Destroy();
}
